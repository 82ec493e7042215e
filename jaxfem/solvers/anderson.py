"""Anderson acceleration of a fixed point x = g(x): the last few steps tell how g bends, as a secant does in one number.

Source: Anderson 1965; Walker & Ni 2011 (the form with differences).
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree
from jaxfem.solvers import trees
from jaxfem.tensors import EXACT, matmul

Array = jax.Array

DEPTH = 6
"""Differences kept."""
RIDGE = {True: 1e-10, False: 1e-5}
"""Added to the diagonal of the least squares' matrix, which is scaled to 1, in double and in single precision:
differences may depend on each other."""


class History(Pytree):
    """The last iterate x and its g(x) - x, and DEPTH differences of each along a leading axis, the latest first."""

    x: Any
    off: Any
    x_steps: Any
    off_steps: Any
    count: Array


def empty(x: Any) -> History:
    """No history yet, for iterates like x."""
    none = jax.tree.map(lambda leaf: jnp.zeros((DEPTH, *leaf.shape), leaf.dtype), x)
    return History(trees.zeros(x), trees.zeros(x), none, none, jnp.int32(0))


def accelerated(history: History, x: Any, image: Any, weights: Any) -> tuple[Any, History]:
    """The next iterate from g(x) = `image`, and the history with this one; differences are weighed by `weights`."""
    off = trees.minus(image, x)
    known = history.count > 0
    x_steps = _pushed(history.x_steps, trees.minus(x, history.x), known)
    off_steps = _pushed(history.off_steps, trees.minus(off, history.off), known)
    used = jnp.arange(DEPTH) < history.count
    share = _fitted(off_steps, off, weights, used)
    both = jax.tree.map(jnp.add, x_steps, off_steps)
    following = jax.tree.map(lambda leaf, steps: leaf - jnp.tensordot(share, steps, 1, precision=EXACT), image, both)
    return following, History(x, off, x_steps, off_steps, jnp.minimum(history.count + 1, DEPTH).astype(jnp.int32))


def _pushed(steps: Any, step: Any, known: Array) -> Any:
    return jax.tree.map(lambda s, new: jnp.where(known, jnp.concatenate([new[None], s[:-1]]), s), steps, step)


def _fitted(steps: Any, off: Any, weights: Any, used: Array) -> Array:
    """Shares of the steps that make up `off` best, by weighted least squares; zero for those not `used`."""

    def part(s: Array, r: Array, w: Array) -> tuple[Array, Array]:
        flat = s.reshape(DEPTH, -1)
        weighed = flat * w.ravel()
        return matmul(weighed, flat.T), matmul(weighed, r.ravel())

    parts = [part(*leaves) for leaves in zip(*map(jax.tree.leaves, (steps, off, weights)), strict=True)]
    matrix, right = (sum(each[1:], start=each[0]) for each in zip(*parts, strict=True))
    diagonal = jnp.diagonal(matrix)
    used = used & (diagonal > jnp.finfo(diagonal.dtype).tiny)
    scale = jnp.where(used, diagonal, 1) ** -0.5 * used
    ridge = RIDGE[diagonal.dtype.itemsize > 4]
    share = scale * jnp.linalg.solve(
        matrix * scale[:, None] * scale + jnp.diag(jnp.where(used, ridge, 1)), scale * right
    )
    return jnp.where(jnp.isfinite(share).all(), share, 0)
