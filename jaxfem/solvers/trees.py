"""Vector arithmetic on pytrees of arrays: unknowns may come as blocks of rows of several shapes."""

from functools import reduce
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

T = TypeVar("T")


def dot(a: Any, b: Any) -> Array:
    """Inner product of two pytrees of one structure; in full precision, also where products default to less."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return reduce(jnp.add, [jnp.vdot(u, v, precision=jax.lax.Precision.HIGHEST) for u, v in pairs])


def dot_by_lane(a: Any, b: Any) -> Array:
    """Inner products over all axes but the last one, which is that of lanes."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    found: Array = reduce(jnp.add, [(u * v).sum(tuple(range(u.ndim - 1))) for u, v in pairs])
    return found


def norm(a: Any) -> Array:
    """Euclidean norm of a pytree."""
    return jnp.sqrt(dot(a, a))


def plus(a: T, scale: Any, b: T) -> T:
    """a + scale * b."""
    total: T = jax.tree.map(lambda u, v: u + scale * v, a, b)
    return total


def minus(a: T, b: T) -> T:
    """a - b."""
    difference: T = jax.tree.map(lambda u, v: u - v, a, b)
    return difference


def times(a: T, b: T) -> T:
    """a * b, entry by entry."""
    product: T = jax.tree.map(lambda u, v: u * v, a, b)
    return product


def where(condition: Any, a: T, b: T) -> T:
    """a where the scalar condition holds, otherwise b."""
    chosen: T = jax.tree.map(lambda u, v: jnp.where(condition, u, v), a, b)
    return chosen


def zeros(a: T) -> T:
    """Zeros of the shapes and dtypes of a."""
    none: T = jax.tree.map(jnp.zeros_like, a)
    return none


def size(a: Any) -> int:
    """Number of entries."""
    return sum(leaf.size for leaf in jax.tree.leaves(a))


def dtype(a: Any) -> Any:
    """The dtype that arithmetic among all entries has."""
    return jnp.result_type(*jax.tree.leaves(a))
