"""A linear system of few rows by elimination of its whole matrix, which is made of products with it.

For what iterations do not reach: a matrix without symmetry, one of whose directions only a trace of compliance holds,
so that a preconditioner carries rounding up to the size of the solution. And for the very few rows of a body or two,
where iterations are no faster.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxfem.solvers import trees
from jaxfem.solvers.status import SolveInfo

T = TypeVar("T")

FEW = 32
"""Rows up to which the matrix is made without trying iterations first: they take as long, and compile longer. For more
rows the library that factorises uses several threads, which wait for each other on a busy processor."""
MOST = 2048
"""Rows up to which the matrix is made where iterations do not converge: it costs as many products as there are rows."""
TOGETHER = 512
"""Products that are made at once: each holds arrays as long as all rows."""


def by_elimination(matvec: Callable[[T], T], right: T, weights: T) -> tuple[T, SolveInfo]:
    """The solution of matvec(x) = right, made better once by its residual, and info; `weights`: sizes of the diagonal.

    Not finite, with a residual that is not, where the matrix is singular.
    """
    flat, shaped = ravel_pytree(right)
    root = jnp.sqrt(ravel_pytree(weights)[0])

    def scaled(column: jax.Array) -> jax.Array:
        product: jax.Array = ravel_pytree(matvec(shaped(column / root)))[0] / root
        return product

    factor = jax.scipy.linalg.lu_factor(_columns(scaled, flat))
    wanted = flat / root

    def better(_: int, last: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        found = last[1]
        left = wanted - scaled(found)
        return found, found + jax.scipy.linalg.lu_solve(factor, left), jnp.linalg.norm(left)

    # The solution, the better one, and what that leaves: a loop, so that products with the matrix are compiled once.
    zero, size = jnp.zeros_like(wanted), jnp.linalg.norm(wanted)
    found, _, residual = jax.lax.fori_loop(0, 3, better, (zero, zero, size))
    relative = residual / jnp.where(size > 0, size, 1)
    none = jnp.int32(0)
    return shaped(found / root), SolveInfo(none, jnp.int32(flat.size), relative, none)


def _columns(product: Callable[[jax.Array], jax.Array], like: jax.Array) -> jax.Array:
    """The matrix (n, n) of a product with vectors like `like` (n,)."""
    unit, parts = jnp.eye(like.size, dtype=like.dtype), -(-like.size // TOGETHER)
    if parts == 1:
        together: jax.Array = jax.vmap(product, out_axes=1)(unit)
        return together
    columns: jax.Array = jax.lax.map(product, unit, batch_size=-(-like.size // parts))
    return columns.T


def scaled_size(rows: T, weights: T) -> jax.Array:
    """Euclidean norm of residuals of rows, each entry over the root of its weight."""
    return trees.norm(jax.tree.map(lambda row, weight: row / jnp.sqrt(weight), rows, weights))


def left_over(matvec: Callable[[T], T], right: T, weights: T, found: T) -> jax.Array:
    """|right - matvec(found)| over |right|, by `scaled_size`; not by any recurrence."""
    whole = scaled_size(right, weights)
    left = scaled_size(trees.minus(right, matvec(found)), weights)
    relative: jax.Array = left / jnp.where(whole > 0, whole, 1)
    return relative
