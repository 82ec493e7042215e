"""Places as weighted means of the corners of tetrahedra, differentiable in both."""

import jax
import jax.numpy as jnp

from jaxfem.tensors import contract

Array = jax.Array


def barycentric(corners: Array, places: Array) -> Array:
    """Weights (m, 4), sum 1, with which `corners` (m, 4, 3) [m] have their mean at `places` (m, 3)."""
    a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
    way = places - corners[:, 0]
    across = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], 1)
    others = contract("mai,mi->ma", across, way) / jnp.sum(a * across[:, 0], -1)[:, None]
    return jnp.concatenate([1 - others.sum(1, keepdims=True), others], 1)


def foot_weights(corners: Array, places: Array, active: Array) -> Array:
    """Weights (m, 4) of the point nearest to `places` (m, 3) among means of the `active` (m, 4) corners (m, 4, 3).

    Least |sum w x - p|^2 with sum w = 1, w = 0 where a corner takes no part: one linear system for the inside, for
    faces, edges and corners, lengths in units of each tetrahedron's own.
    """
    way = corners - places[:, None]
    size = jax.lax.stop_gradient(jnp.max(jnp.abs(corners - corners[:, :1]), axis=(1, 2)))
    way = jnp.where(active[..., None], way / size[:, None, None], 0)
    gram = contract("mai,mbi->mab", way, way) + jnp.eye(4, dtype=way.dtype) * jnp.where(active, 0, 1)[:, :, None]
    ones = active.astype(gram.dtype)
    top = jnp.concatenate([gram, ones[:, :, None]], 2)
    bottom = jnp.concatenate([ones[:, None, :], jnp.zeros((len(ones), 1, 1), gram.dtype)], 2)
    right = jnp.zeros((len(ones), 5), gram.dtype).at[:, 4].set(1)
    found: Array = jnp.linalg.solve(jnp.concatenate([top, bottom], 1), right[..., None])[:, :4, 0]
    return found
