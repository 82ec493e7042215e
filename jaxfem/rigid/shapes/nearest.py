"""Exact signed distance to a triangulated surface, open or closed: the nearest triangle of a few that may be it.

Outside or inside is told by the normal of the nearest feature (face, edge or vertex), the angle-weighted mean of the
faces' around it (Baerentzen & Aanaes 2005). Which triangles may be nearest to the points of a cell of a grid is found
once, on the host: no other can be, unless a cell, as at the middle of a ball, would need more than MOST.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import Pytree
from jaxfem.tensors import inner, matmul

Array = jax.Array

MOST = 96
"""Triangles that a cell of the grid names at most."""
FINEST = 24  # cells along each side of the grid
CHUNK = 1024  # cells that are looked at together
FEW = 24  # triangles that are looked at one and all, without a grid
PADDING = 0.25  # of the surface's size, around it
TOUCHING = 1e-9  # of a triangle's size: how near an edge or vertex its own normal takes over


class NearestTriangles(Pytree):
    """A surface as contact measures it.

    `corners` (t, 3, 3) [m], `normals` (t, 7, 3): of the face, of its edges 01, 12, 20, and of its vertices; `lists`
    (nx, ny, nz, k): triangles that may be nearest in each cell of a grid from `origin` (3,) [m] at `spacing` (3,) [m].
    """

    corners: Any
    normals: Any
    lists: Any
    origin: Any
    spacing: Any

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]; exact to first order where two triangles are equally near."""
        corners, lists = jnp.asarray(self.corners), jnp.asarray(self.lists)
        at = (jax.lax.stop_gradient(point) - jnp.asarray(self.origin)) / jnp.asarray(self.spacing)
        cell = jnp.clip(jnp.floor(at), 0, jnp.array(lists.shape[:3]) - 1).astype(jnp.int32)
        near = lists[cell[0], cell[1], cell[2]]
        squares = square_distances(jnp, *jax.lax.stop_gradient((point, corners[near])))[0]
        chosen = near[jnp.argmin(squares)]
        return distance_to(point, corners[chosen], jnp.asarray(self.normals)[chosen])


def distance_to(point: Array, corners: Array, normals: Array) -> Array:
    """Signed distance of a point (3,) from one triangle (3, 3), by the normals (7, 3) of its features."""
    _, weights, feature = square_distances(jnp, point, corners)
    normal = normals[jax.lax.stop_gradient(feature)]
    way = point - matmul(weights, corners)
    height, square = inner(normal, way), inner(way, way)
    least = TOUCHING**2 * jnp.sum((corners[1] - corners[0]) ** 2)
    beside = (feature > 0) & (square > least)
    length = jnp.sqrt(jnp.where(beside, square, 1))
    return jnp.where(beside, jnp.where(height < 0, -length, length), height)


def square_distances(xp: Any, point: Any, corners: Any) -> tuple[Any, Any, Any]:
    """Of a point (..., 3) from triangles (..., 3, 3): squares (...), weights (..., 3) of the nearest point, and its
    feature (...): 0 inside, 1 to 3 on edges 01, 12, 20, 4 to 6 at vertices. `xp`: NumPy or its namesake of JAX."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    u, v, w = b - a, c - a, point - a
    uu, uv, vv, wu, wv = ((x * y).sum(-1) for x, y in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = uu * vv - uv * uv
    area = xp.where(area > 0, area, 1)
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    places = [_share(xp, p, q, point) for p, q in ((a, b), (b, c), (c, a))]
    zero = xp.zeros_like(s)
    weights = xp.stack(
        [
            xp.stack([1 - s - t, s, t], -1),
            xp.stack([1 - places[0], places[0], zero], -1),
            xp.stack([zero, 1 - places[1], places[1]], -1),
            xp.stack([places[2], zero, 1 - places[2]], -1),
        ],
        -2,
    )
    ways = point[..., None, :] - (weights[..., None] * corners[..., None, :, :]).sum(-2)
    squares = (ways**2).sum(-1)
    first = xp.where(inside, squares[..., 0], np.inf)
    squares = xp.concatenate([first[..., None], squares[..., 1:]], -1)
    best = squares.argmin(-1)
    weights = xp.take_along_axis(weights, best[..., None, None], -2)[..., 0, :]
    vertex = weights.argmax(-1)
    feature = xp.where((best > 0) & (weights.max(-1) >= 1), 4 + vertex, best)
    return xp.take_along_axis(squares, best[..., None], -1)[..., 0], weights, feature


def _share(xp: Any, a: Any, b: Any, point: Any) -> Any:
    """Where the nearest point is on the edge from a to b, in shares of its length; by selections, as in `within`."""
    along = b - a
    square = (along * along).sum(-1)
    share = ((point - a) * along).sum(-1) / (square + (square == 0))
    return xp.where(share < 0, 0, xp.where(share > 1, 1, share))


def nearest_triangles(points: np.ndarray, triangles: np.ndarray) -> NearestTriangles:
    """A surface of `points` (n, 3) [m] and `triangles` (t, 3), turned outward, made ready; host side."""
    corners = points[triangles]
    low, high = points.min(0), points.max(0)
    pad = PADDING * (high - low).max()
    origin, size = low - pad, high - low + 2 * pad
    cells, lists = np.ones(3, int), np.arange(len(triangles))[None]
    if len(triangles) > FEW:
        edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=-1).mean()
        cells = np.clip(np.ceil(size / max(edge, size.max() / FINEST)), 1, FINEST).astype(int)
        lists = _lists(corners, origin, size / cells, cells)
    shaped = lists.reshape(*cells, -1).astype(np.int32)
    return NearestTriangles(corners, feature_normals(points, triangles), shaped, origin, size / cells)


def feature_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Normals (t, 7, 3) of each triangle's face, edges and vertices: means of the faces' around, weighted by angle."""
    corners = points[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    at_vertex = np.zeros_like(points, dtype=float)
    for k in range(3):
        one, other = (corners[:, (k + i) % 3] - corners[:, k] for i in (1, 2))
        cosine = (one * other).sum(1) / np.maximum(np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1), 1e-300)
        np.add.at(at_vertex, triangles[:, k], np.arccos(np.clip(cosine, -1, 1))[:, None] * face)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, 1)], -1).reshape(-1, 2), 1)
    _, number = np.unique(edges, axis=0, return_inverse=True)
    number = number.reshape(-1)
    at_edge = np.zeros((number.max() + 1, 3))
    np.add.at(at_edge, number, np.repeat(face, 3, axis=0))
    found = np.concatenate([face[:, None], at_edge[number].reshape(-1, 3, 3), at_vertex[triangles]], 1)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=-1, keepdims=True), 1e-300))


def _lists(corners: np.ndarray, origin: np.ndarray, spacing: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Triangles (cells, k) that may be nearest to a point of each cell, the likeliest first; the first fills up."""
    from scipy.spatial import cKDTree  # slow to import: only where there is such a surface

    index = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), -1).reshape(-1, 3)
    middles = origin + (index + 0.5) * spacing
    across = float(np.linalg.norm(spacing))  # twice as far as a point of a cell is from its middle
    centres = corners.mean(1)
    radius = np.linalg.norm(corners - centres[:, None], axis=-1).max()
    tree = cKDTree(centres)
    near = tree.query_ball_point(middles, tree.query(middles)[0] + across + radius)
    kept = [
        _likeliest(middles[k : k + CHUNK], corners, near[k : k + CHUNK], across) for k in range(0, len(index), CHUNK)
    ]
    width = max(each.shape[1] for each in kept)
    return np.concatenate(
        [np.concatenate([each, np.repeat(each[:, :1], width - each.shape[1], 1)], 1) for each in kept]
    )


def _likeliest(middles: np.ndarray, corners: np.ndarray, near: Sequence[Sequence[int]], across: float) -> np.ndarray:
    count = np.array([len(each) for each in near])
    own, triangle = np.repeat(np.arange(len(near)), count), np.concatenate([np.asarray(each, int) for each in near])
    away = np.sqrt(square_distances(np, middles[own], corners[triangle])[0])
    order = np.lexsort((away, own))
    own, triangle, away = own[order], triangle[order], away[order]
    starts = np.cumsum(count) - count
    rank = np.arange(len(own)) - starts[own]
    fits = (away <= away[starts][own] + across) & (rank < MOST)
    found = np.repeat(triangle[starts][:, None], rank[fits].max() + 1, 1)
    found[own[fits], rank[fits]] = triangle[fits]
    return found
