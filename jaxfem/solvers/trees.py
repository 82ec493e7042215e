"""Vector arithmetic on pytrees of arrays: unknowns may come as blocks of rows of several shapes, never concatenated."""

from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array


def dot(a: Any, b: Any) -> Array:
    """Inner product of two pytrees of one structure; in full precision, also where products default to less."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return reduce(jnp.add, [jnp.vdot(u, v, precision=jax.lax.Precision.HIGHEST) for u, v in pairs])


def norm(a: Any) -> Array:
    """Euclidean norm of a pytree."""
    return jnp.sqrt(dot(a, a))


def plus(a: Any, scale: Any, b: Any) -> Any:
    """a + scale * b."""
    return jax.tree.map(lambda u, v: u + scale * v, a, b)


def minus(a: Any, b: Any) -> Any:
    """a - b."""
    return jax.tree.map(lambda u, v: u - v, a, b)


def times(a: Any, b: Any) -> Any:
    """a * b, entry by entry."""
    return jax.tree.map(lambda u, v: u * v, a, b)


def where(condition: Any, a: Any, b: Any) -> Any:
    """a where the scalar condition holds, otherwise b."""
    return jax.tree.map(lambda u, v: jnp.where(condition, u, v), a, b)


def zeros(a: Any) -> Any:
    """Zeros of the shapes and dtypes of a."""
    return jax.tree.map(jnp.zeros_like, a)


def size(a: Any) -> int:
    """Number of entries."""
    return sum(leaf.size for leaf in jax.tree.leaves(a))


def dtype(a: Any) -> Any:
    """The dtype that arithmetic among all entries has."""
    return jnp.result_type(*jax.tree.leaves(a))
