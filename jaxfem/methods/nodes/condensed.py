"""Rows eliminated onto the nodes: preconditioned conjugate gradients on the increment of velocity."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import lanes_in_turn
from jaxfem.methods.nodes.assembly import BlockMatrix, assemble_rows
from jaxfem.methods.nodes.preconditioner import coarse_inverse, rigid_modes, two_level
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo
from jaxfem.system.soft import System, momentum_gradient

Array = jax.Array


def condensed_matrix(system: System) -> BlockMatrix:
    """M + J' C^-1 J of the step's nodes in solver order, fixed nodes decoupled."""
    nodes = system.positions.shape[0]
    mass, free = system.mass[:nodes], system.free[:nodes]
    return assemble_rows(system.elastic, mass, free, system.pattern, system.shared_mass)


def linearised(system: System, velocities: Array | None = None, definite: Any = 0) -> System:
    """The system with the tangent of each law that is not linear, made at `velocities` (n, 3) of all triples.

    None: where they are zero. `definite`: see `LawRows.tangent`. Nothing is done where all laws are linear.
    """
    if not system.nonlinear:
        return system
    at = jnp.zeros_like(system.target) if velocities is None else velocities
    elastic = tuple(each.tangent(at, definite) for each in system.elastic)
    return system.replace(elastic=elastic)  # for the matrix alone: it knows no impulses


def group_modes(system: System) -> Array:
    """Rigid modes of the preconditioner's groups at the start-of-step shape."""
    rotations = [rows.rotation for rows in system.elastic if not rows.domains.volumetric]
    free = system.free[: system.positions.shape[0]]
    return rigid_modes(system.pattern, system.positions, free, jnp.concatenate(rotations, axis=-1))


def coarse_of(system: System) -> Array:
    """The coarse inverse that `solve_linear` takes, built for this step's shape and numbers."""
    return jax.lax.stop_gradient(_coarse_inverse(jax.lax.stop_gradient(linearised(system))))


@lanes_in_turn
def _coarse_inverse(system: System) -> Array:
    return coarse_inverse(condensed_matrix(system), group_modes(system))


@lanes_in_turn
def solve_linear(system: System, coarse: Array, right: Array, absolute: Any = 0.0) -> tuple[Array, SolveInfo]:
    """Solve the condensed system for `right` (n, 3) by two-level conjugate gradients: (solution, info).

    `coarse`: the preconditioner's coarse inverse, built at this or at an earlier shape (see `coarse_of`).
    """
    matrix, pattern = condensed_matrix(system), system.pattern
    solution, info = pcg(
        matrix.apply,
        pattern.gathered(right),
        two_level(matrix, group_modes(system), coarse),
        tol=system.tolerance,
        max_iterations=system.max_iterations,
        absolute=absolute,
    )
    return pattern.scattered(solution), info


@lanes_in_turn
def solve_condensed(system: System, coarse: Array, guess: Array) -> tuple[Array, SolveInfo]:
    """End-of-step velocities of the free nodes (n, 3) from a guess, and info; no impulses are formed.

    The residual is formed element by element at the guess, so rigid motion cancels there and float32 keeps its digits;
    only the increment goes through the assembled matrix.
    """
    free = system.free[:, None]
    guess = guess * free
    increment, info = solve_linear(system, coarse, -momentum_gradient(system, guess), system.floor)
    return guess + increment * free, info
