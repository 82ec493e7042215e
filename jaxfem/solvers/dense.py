"""Inverse of a small dense positive definite matrix, in plain JAX.

The library that JAX calls for such matrices gives even 33 rows to several threads, which wait for each other by turning
around: a thousand times slower on a busy processor. This one takes as long as that library with one thread.
"""

import jax
import jax.numpy as jnp
from jax import lax

from jaxfem.tensors import EXACT

Array = jax.Array

BLOCK = 8


def dense_inverse(matrix: Array) -> Array:
    """Inverse of a symmetric positive definite matrix (m, m); all NaN where a pivot is not positive.

    Every block of rows is swept in turn, which leaves -A^-1 (the symmetric sweep operator; Beaton 1964, Goodnight
    1979). Without exchanges of rows: a definite matrix needs none.
    """
    size = matrix.shape[0]
    padded = size + -size % BLOCK
    whole = jnp.eye(padded, dtype=matrix.dtype).at[:size, :size].set(matrix)

    def sweep(block: Array, a: Array) -> Array:
        first = block * BLOCK
        rows = lax.dynamic_slice(a, (first, 0), (BLOCK, padded))
        pivot = _swept(lax.dynamic_slice(rows, (0, first), (BLOCK, BLOCK)))
        share = -jnp.matmul(pivot, rows, precision=EXACT)
        a = a - jnp.matmul(rows.T, share, precision=EXACT)
        a = lax.dynamic_update_slice(a, share, (first, 0))
        a = lax.dynamic_update_slice(a, share.T, (0, first))
        return lax.dynamic_update_slice(a, pivot, (first, first))

    swept: Array = lax.fori_loop(0, padded // BLOCK, sweep, whole)
    return -swept[:size, :size]


def _swept(block: Array) -> Array:
    """Minus the inverse of one small block, a row at a time."""
    index = jnp.arange(block.shape[0])

    def sweep(at: Array, a: Array) -> Array:
        row, here = a[at], index == at
        pivot = jnp.where(row[at] > 0, row[at], jnp.nan)
        share = row / pivot
        rest = jnp.where(here[:, None], share, jnp.where(here, share[:, None], a - row[:, None] * share))
        return jnp.where(here[:, None] & here, -1 / pivot, rest)

    swept: Array = lax.fori_loop(0, block.shape[0], sweep, block)
    return swept
