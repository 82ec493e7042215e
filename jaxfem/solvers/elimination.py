"""Cholesky factor of a sparse matrix of small blocks, in an order found before (see `elimination_order.py`).

Leaves v of a round, with neighbours u:  G_uv = A_uv A_vv^-1,  A_uu' -= G_uv A_vu'.  The core, block tridiagonal with
diagonal blocks D_k and E_k below them:  L_k L_k' = D_k - X_{k-1}' X_{k-1},  X_k = L_k^-1 E_k'.
Small blocks are kept with the nodes along the last axis: arithmetic is then entry by entry over many nodes at once.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.indexing import gather
from jaxfem.pytrees import Pytree
from jaxfem.solvers.elimination_order import Core, EliminationOrder, Leaves, upper_pairs
from jaxfem.tensors import EXACT

Array = jax.Array


class EliminationFactor(Pytree):
    """Inverses (R, s, s, m) and ratios G (R, w, s, s, m) of each class of leaves; of the core the L_k^-1, and X_k."""

    inverses: tuple[Array, ...]
    ratios: tuple[Array, ...]
    lower: Array | None
    across: Array | None


def factorise(order: EliminationOrder, diagonal: Array, beside: Array) -> EliminationFactor:
    """Factor of the matrix with blocks `diagonal` (N, s, s) and `beside` (P, s, s), those of `order.pairs`.

    NaN or infinite where the matrix is not positive definite to rounding.
    """
    s = diagonal.shape[-1]
    ends = jnp.stack([jnp.zeros((s, s), diagonal.dtype), jnp.eye(s, dtype=diagonal.dtype)])
    table = jnp.concatenate([diagonal, beside, ends])
    inverses, ratios = [], []
    for leaves in order.leaves:
        table, (inverse, ratio) = jax.lax.scan(partial(_eliminate, diagonal.shape[0]), table, leaves)
        inverses.append(inverse)
        ratios.append(ratio)
    if order.core is None:
        return EliminationFactor(tuple(inverses), tuple(ratios), None, None)
    return EliminationFactor(tuple(inverses), tuple(ratios), *_factorise_core(order.core, table))


def solve_factored(order: EliminationOrder, factor: EliminationFactor, right: Array) -> Array:
    """Solve A x = right, (N, s) both."""
    field = jnp.concatenate([right, jnp.zeros_like(right[:1])])
    for leaves, ratio in zip(order.leaves, factor.ratios, strict=True):
        field = jax.lax.scan(_forward, field, (leaves, ratio))[0]
    if order.core is not None:
        field = _solve_core(order.core, factor, field)
    for leaves, inverse, ratio in reversed(list(zip(order.leaves, factor.inverses, factor.ratios, strict=True))):
        field = jax.lax.scan(_backward, field, (leaves, inverse, ratio), reverse=True)[0]
    return field[:-1]


def inverse_definite(blocks: Array) -> Array:
    """Inverses of symmetric positive definite blocks (s, s, m) by Gauss-Jordan sweeps, without pivots."""
    size = blocks.shape[0]
    for k in range(size):
        pivot = 1 / blocks[k, k]
        column = blocks[:, k] * pivot
        swept = blocks - column[:, None] * blocks[k][None]
        # the pivot's row and column take the places of the identity's
        swept = swept.at[k].set(blocks[k] * pivot).at[:, k].set(-column)
        blocks = swept.at[k, k].set(pivot)
    return blocks


def product(a: Array, b: Array) -> Array:
    """a b for blocks (s, t, m), (t, u, m)."""
    total = a[:, 0, None] * b[None, 0]
    for k in range(1, a.shape[1]):
        total = total + a[:, k, None] * b[None, k]
    return total


def _eliminate(count: int, table: Array, leaves: Leaves) -> tuple[Array, tuple[Array, Array]]:
    own = jnp.where(leaves.nodes < count, leaves.nodes, table.shape[0] - 1)
    inverse = inverse_definite(_last(gather(table, own)))
    width = leaves.others.shape[-1]
    beside = [_last(gather(table, leaves.beside[:, w])) for w in range(width)]
    ratios = [product(each, inverse) for each in beside]
    changes = [product(ratios[a], beside[b].swapaxes(0, 1)) for a, b in upper_pairs(width)]
    for number, change in enumerate(changes):
        table = table.at[leaves.targets[:, number]].add(-jnp.moveaxis(change, -1, 0))
    empty = jnp.zeros((0, *inverse.shape), inverse.dtype)
    return table, (inverse, jnp.stack(ratios) if ratios else empty)


def _forward(field: Array, inputs: Any) -> tuple[Array, None]:
    leaves, ratio = inputs
    own = gather(field, leaves.nodes).T
    for w in range(ratio.shape[0]):
        field = field.at[leaves.others[:, w]].add(-_times(ratio[w], own).T)
    return field, None


def _backward(field: Array, inputs: Any) -> tuple[Array, None]:
    leaves, inverse, ratio = inputs
    own = _times(inverse, gather(field, leaves.nodes).T)
    for w in range(ratio.shape[0]):
        own = own - _times(ratio[w].swapaxes(0, 1), gather(field, leaves.others[:, w]).T)
    return field.at[leaves.nodes].set(own.T), None


def _times(blocks: Array, vectors: Array) -> Array:
    """Blocks (s, t, m) times vectors (t, m)."""
    return product(blocks, vectors[:, None])[:, 0]


def _last(blocks: Array) -> Array:
    return jnp.moveaxis(blocks, 0, -1)


def _factorise_core(core: Core, table: Array) -> tuple[Array, Array]:
    number, size = core.nodes.shape
    s = table.shape[-1]

    def dense(index: Array) -> Array:
        return gather(table, index).swapaxes(1, 2).reshape(size * s, size * s)

    eye = jnp.eye(size * s, dtype=table.dtype)

    def one(taken: Array, inputs: Any) -> tuple[Array, tuple[Array, Array]]:
        diagonal, below = inputs
        root = jax.lax.linalg.cholesky(dense(diagonal) - taken, symmetrize_input=False)
        lower = jax.scipy.linalg.solve_triangular(root, eye, lower=True)
        if number == 1:
            return taken, (lower, taken[:0])
        across = jnp.matmul(lower, dense(below).T, precision=EXACT)
        return jnp.matmul(across.T, across, precision=EXACT), (lower, across)

    return jax.lax.scan(one, jnp.zeros_like(eye), (core.diagonal, core.below))[1]


def _solve_core(core: Core, factor: EliminationFactor, field: Array) -> Array:
    lower, across = factor.lower, factor.across
    assert lower is not None and across is not None
    right = gather(field, core.nodes).reshape(core.nodes.shape[0], -1)
    if core.nodes.shape[0] == 1:
        x = jnp.matmul(lower[0].T, jnp.matmul(lower[0], right[0], precision=EXACT), precision=EXACT)[None]
    else:

        def down(taken: Array, inputs: Any) -> tuple[Array, Array]:
            inverse, beyond, part = inputs
            solved = jnp.matmul(inverse, part - taken, precision=EXACT)
            return jnp.matmul(solved, beyond, precision=EXACT), solved

        def up(above: Array, inputs: Any) -> tuple[Array, Array]:
            inverse, beyond, part = inputs
            solved = jnp.matmul(part - jnp.matmul(beyond, above, precision=EXACT), inverse, precision=EXACT)
            return solved, solved

        middle = jax.lax.scan(down, jnp.zeros_like(right[0]), (lower, across, right))[1]
        x = jax.lax.scan(up, jnp.zeros_like(right[0]), (lower, across, middle), reverse=True)[1]
    return field.at[core.nodes].set(x.reshape(*core.nodes.shape, -1)).at[-1].set(0)
