"""The triangle nearest to each of some points, of those that it may meet."""

import jax
import jax.numpy as jnp

from jaxfem.tensors import contract

Array = jax.Array


def nearest_triangle(
    points: Array, nodes: Array, triangles: Array, outward: Array | None = None
) -> tuple[Array, Array, Array]:
    """For points (m, 3): the nearest (m, 3) of their `triangles` (m, t, 3) over `nodes` (n, 3), barycentric weights
    (m, 3) of the nearest point on it, and its unit normal (m, 3).

    Of triangles about equally near, one that looks against `outward` (m, 3) is taken, where that is given and the point
    is over such a one, or hardly beyond it.
    The choice is not differentiated, the weights are: those of the foot of the perpendicular, held inside the triangle.
    Close to an edge or a corner that triangles share, and beyond it, the normal is the mean of theirs.
    """
    fixed_points, fixed_nodes = jax.lax.stop_gradient((points, nodes))
    squares = _square_distances(fixed_points, fixed_nodes[triangles])
    if outward is not None:
        squares = _facing_first(squares, fixed_nodes[triangles], jax.lax.stop_gradient(outward))
    tied = _tied(squares, fixed_nodes[triangles])
    nearest = jnp.argmax(tied, axis=1)[:, None]
    chosen = jnp.take_along_axis(triangles, nearest[:, :, None], axis=1)[:, 0]
    first, second, third = (nodes[triangles[:, :, i]] for i in range(3))
    across = jnp.cross(second - first, third - first)
    own = jnp.take_along_axis(across, nearest[:, :, None], axis=1)
    alike = tied & (jnp.min(squares, axis=1) < ASIDE**2 * _length(own[:, 0]))[:, None]
    if outward is not None:  # of those that the body meets, one face's
        alike = alike & (jnp.sum(across * own, -1) > ALIKE * _length(across) * _length(own))
    alike = alike | (jnp.arange(tied.shape[1]) == nearest)
    normal = jnp.sum(jnp.where(alike[:, :, None], across, 0), axis=1)
    weights = _held(_weights(points, *(nodes[chosen[:, i]] for i in range(3))))
    return chosen, weights, normal / _length(normal)[:, None]


TIE = 8.0
"""Times the precision and the square of a triangle's size: squares of distances that are taken for equal."""
ALIKE = 0.7
"""Cosine between normals of triangles of one face: those around its rim do not count."""

ASIDE = 0.02
"""Share of a triangle's size from which a point beyond its edge is no longer over it."""


def gap_from(points: Array, weights: Array, normal: Array, corners: Array, share: float = ASIDE) -> tuple[Array, Array]:
    """Gap (m,) and normal (m, 3) of points (m, 3) from places on triangles: `weights` (m, 3) of `corners` (m, 3, 3).

    Along the triangle's normal; far aside of it, beyond an edge of the surface, along the way from the edge: what hangs
    over is not carried. Near the edge, up to a `share` of its size, the triangle goes on: two faces laid edge on edge
    would else lose their hold.
    """
    # Of ways from the corners, which are short: places are rounded by their distance from the origin.
    way = jnp.sum(weights[:, :, None] * (points[:, None] - corners), 1)
    height, square = jnp.sum(way * normal, -1), jnp.sum(way**2, -1)
    beyond, _ = aside(way, normal, corners, share)
    length = jnp.sqrt(jnp.where(beyond, square, 1))
    length = jnp.where(height < -0.5 * length, -length, length)  # beneath a concave edge
    return jnp.where(beyond, length, height), jnp.where(beyond[:, None], way / length[:, None], normal)


def aside(way: Array, normal: Array, corners: Array, share: float = ASIDE) -> tuple[Array, Array]:
    """Whether points a `way` (m, 3) from the feet on their triangles are no longer over them, and twice the triangles'
    areas, (m,) each."""
    area = jnp.linalg.norm(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    return jnp.sum(way**2, -1) - jnp.sum(way * normal, -1) ** 2 > share**2 * area, area


def _tied(squares: Array, corners: Array) -> Array:
    """Which of triangles `corners` (m, t, 3, 3) have the least of `squares` (m, t), but for rounding.

    A point beyond an edge or a corner that triangles share is as near to each of them: rounding would choose, and what
    hangs on their normals would jump from run to run. Nodes on nodes, with a row from either side, need one normal.
    """
    edges = jnp.sum((corners[:, :, 1:] - corners[:, :, :1]) ** 2, -1)
    least = jnp.min(squares, axis=1, keepdims=True)
    equal = TIE * jnp.finfo(squares.dtype).eps * (least + jnp.max(edges, axis=(1, 2))[:, None])
    tied: Array = squares <= least + equal
    return tied


def _length(vectors: Array) -> Array:
    length: Array = jnp.linalg.norm(vectors, axis=-1)
    return length


def _facing_first(squares: Array, corners: Array, outward: Array) -> Array:
    """Of `squares` (m, t) of distances to triangles `corners` (m, t, 3, 3), those of triangles that do not look against
    `outward` (m, 3) made larger where one that does is near."""
    across = jnp.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    near = ASIDE**2 * _length(across)
    facing = contract("mti,mi->mt", across, outward) < 0
    met = jnp.any(facing & (squares < near), axis=1, keepdims=True)
    first: Array = squares + jnp.where(met & ~facing, near, 0)
    return first


def areas_around(nodes: Array, around: Array) -> Array:
    """Sums (m, 3) of the normals of triangles `around` (m, f, 3) points over `nodes` (n, 3), times their areas."""
    first, second, third = (nodes[around[:, :, i]] for i in range(3))
    total: Array = 0.5 * jnp.sum(jnp.cross(second - first, third - first), axis=1)
    return total


def _square_distances(points: Array, corners: Array) -> Array:
    """(m, t), to the nearest point of each triangle."""
    a, b, c = (corners[:, :, i] for i in range(3))
    p = points[:, None]
    inside = _weights(p, a, b, c)
    foot = inside[..., :1] * a + inside[..., 1:2] * b + inside[..., 2:] * c
    plane = jnp.where(jnp.all(inside >= 0, -1), jnp.sum((p - foot) ** 2, -1), jnp.inf)
    edges = [_edge_square(p, *pair) for pair in ((a, b), (b, c), (c, a))]
    return jnp.minimum(plane, jnp.minimum(jnp.minimum(edges[0], edges[1]), edges[2]))


def _weights(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Barycentric weights (..., 3) of the foot of the perpendicular on the triangle's plane."""
    u, v, w = b - a, c - a, p - a
    uu, uv, vv = jnp.sum(u * u, -1), jnp.sum(u * v, -1), jnp.sum(v * v, -1)
    wu, wv = jnp.sum(w * u, -1), jnp.sum(w * v, -1)
    area = uu * vv - uv * uv
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    return jnp.stack([1 - s - t, s, t], -1)


def _held(weights: Array) -> Array:
    """Weights moved into the triangle."""
    inside = jnp.maximum(weights, 0)
    return inside / jnp.sum(inside, -1, keepdims=True)


def _edge_square(p: Array, a: Array, b: Array) -> Array:
    along = b - a
    t = jnp.clip(jnp.sum((p - a) * along, -1) / jnp.sum(along * along, -1), 0, 1)
    return jnp.sum((p - a - t[..., None] * along) ** 2, -1)
