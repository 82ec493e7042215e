"""Condensed route: rows eliminated onto the nodes, preconditioned conjugate gradients on the increment of velocity."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.routes.assembly import BlockMatrix, assemble, row_blocks
from jaxfem.routes.system import System, momentum_gradient
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo

Array = jax.Array


def condensed_matrix(system: System) -> BlockMatrix:
    """M + J' C^-1 J of the step, fixed nodes decoupled."""
    return assemble(row_blocks(system.rows[0]), system.mass, system.free, system.pattern)  # type: ignore[arg-type]


def inverse_blocks(blocks: Array) -> Array:
    """Inverses of symmetric 3x3 blocks (n, 3, 3), by cofactors."""
    rows = [blocks[:, i] for i in range(3)]
    cofactors = [jnp.cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)]
    determinant = jnp.sum(rows[0] * cofactors[0], -1)
    return jnp.stack(cofactors, -1) / determinant[:, None, None]


def block_jacobi(matrix: BlockMatrix) -> Callable[[Array], Array]:
    """Inverse of the diagonal blocks, applied to (n, 3)."""
    inverse = inverse_blocks(matrix.diagonal_blocks)
    return lambda r: jnp.einsum("nij,nj->ni", inverse, r)


def solve_linear(system: System, right: Array, absolute: Any = 0.0) -> tuple[Array, SolveInfo]:
    """Solve the condensed system for `right` (n, 3) by block-Jacobi conjugate gradients: (solution, info)."""
    matrix = condensed_matrix(system)
    return pcg(
        matrix.apply,
        right,
        block_jacobi(matrix),
        tol=system.tolerance,
        max_iterations=system.max_iterations,
        absolute=absolute,
    )


def solve_condensed(system: System, guess: Array) -> tuple[Array, tuple[SolveInfo, None]]:
    """End-of-step velocities of the free nodes (n, 3) from a guess, and info; impulses are not formed (None).

    The residual is formed element by element at the guess, so rigid motion cancels there and float32 keeps its digits;
    only the increment goes through the assembled matrix.
    """
    free = system.free[:, None]
    guess = guess * free
    increment, info = solve_linear(system, -momentum_gradient(system, guess), system.floor)
    return guess + increment * free, (info, None)
