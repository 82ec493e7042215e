"""Gathers and scatters by index arrays that were made to fit: no index is negative or beyond the end.

NumPy's rules for any other index (counting from the end, leaving out what is beyond) are traced, lowered and compiled
at every use. What is made with a scene fits. Indices of users are taken in NumPy's way, as those of loads are, or made
to fit where they enter (`PointRows.counted`); so is what may be beyond the end, and is left out there.
"""

import jax
import numpy as np
from jax import lax

Array = jax.Array

_FITS = lax.GatherScatterMode.PROMISE_IN_BOUNDS


def gather(field: Array, index: Array | np.ndarray) -> Array:
    """field[index] of indices from 0 to n - 1, along the first axis: (n, ...) by (i, j, ...) -> (i, j, ..., ...)."""
    beside = tuple(range(index.ndim, index.ndim + field.ndim - 1))
    numbers = lax.GatherDimensionNumbers(beside, collapsed_slice_dims=(0,), start_index_map=(0,))
    return lax.gather(field, _columns(index), numbers, (1, *field.shape[1:]), mode=_FITS)


def scatter_add(values: Array, index: Array | np.ndarray, count: int) -> Array:
    """Sums (count, ...) of `values` (i, j, ..., ...) that go to the places `index` (i, j, ...), 0 to count - 1."""
    beside = tuple(range(index.ndim, values.ndim))
    numbers = lax.ScatterDimensionNumbers(beside, inserted_window_dims=(0,), scatter_dims_to_operand_dims=(0,))
    zeros = lax.full((count, *values.shape[index.ndim :]), 0, values.dtype)
    return lax.scatter_add(zeros, _columns(index), values, numbers, mode=_FITS)


def with_last(field: Array, last: Array) -> Array:
    """`field` (n, ...) with its last entries replaced by `last` (b, ...)."""
    return lax.concatenate([lax.slice_in_dim(field, 0, field.shape[0] - last.shape[0]), last.astype(field.dtype)], 0)


def _columns(index: Array | np.ndarray) -> Array:
    return lax.expand_dims(index, (index.ndim,))
