"""Triangles to look at: of shapes with formulas, and of any signed distance by marching tetrahedra. Host side."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

Outline = tuple[np.ndarray, np.ndarray]
"""Points (n, 3) [m] and triangles (t, 3), seen counter-clockwise from outside."""

ROUND = 32
"""Points around a circle."""
GRID = 20
"""Cells along the longest side of the box in which a signed distance is looked at."""

# The six tetrahedra of a cell that share its diagonal (Kuhn 1960): corners as bits x, y, z.
_KUHN = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
# Of a tetrahedron with so many corners inside, which come first: edges that are cut, three a triangle.
_CUTS: tuple[tuple[int, list[list[list[int]]]], ...] = (
    (1, [[[0, 1], [0, 2], [0, 3]]]),
    (2, [[[0, 2], [0, 3], [1, 3]], [[0, 2], [1, 3], [1, 2]]]),
    (3, [[[0, 3], [1, 3], [2, 3]]]),
)


def revolved(radius: Any, height: Any) -> Outline:
    """The surface that a profile (k,) of `radius` and `height` [m], from below up, sweeps about z, closed at its ends
    where its radius is not 0."""
    radius, height = np.asarray(radius, float), np.asarray(height, float)
    turn = np.arange(ROUND) * (2 * np.pi / ROUND)
    rings = radius[:, None, None] * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    rings[..., 2] += height[:, None]
    poles = np.array([[0, 0, height[0]], [0, 0, height[-1]]])
    a = (np.arange(len(radius) - 1)[:, None] * ROUND + np.arange(ROUND)).ravel()
    b = a - a % ROUND + (a % ROUND + 1) % ROUND
    sides = np.concatenate([np.stack([a, b, b + ROUND], 1), np.stack([a, b + ROUND, a + ROUND], 1)])
    low, high = len(rings) * ROUND, len(rings) * ROUND + 1
    first, last = np.arange(ROUND), (len(rings) - 1) * ROUND + np.arange(ROUND)
    caps = [
        np.stack([np.full(ROUND, low), np.roll(first, -1), first], 1),
        np.stack([np.full(ROUND, high), last, np.roll(last, -1)], 1),
    ]
    return _joined(np.concatenate([rings.reshape(-1, 3), poles]), np.concatenate([sides, *caps]))


def block(low: Any, high: Any) -> Outline:
    """A block between two corners (3,) [m]."""
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    points = np.where(bits == 1, np.asarray(high, float), np.asarray(low, float))
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def gridded(points: np.ndarray) -> Outline:
    """Two triangles for each cell of a grid of points (a, b, 3), turned to the side of the first axis x the second."""
    a, b = points.shape[:2]
    corner = (np.arange(a - 1)[:, None] * b + np.arange(b - 1)).ravel()
    cells = np.stack([corner, corner + b, corner + b + 1, corner + 1], 1)
    return points.reshape(-1, 3), np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])


def level_surface(distance: Callable[[Any], Any], box: np.ndarray) -> Outline:
    """Where `distance` of a point (3,) is 0 within a `box` (2, 3) [m]: marching tetrahedra on a grid (Doi & Koide
    1991), corners on edges by linear interpolation."""
    side = np.ptp(box, axis=0)
    cell = max(float(side.max()), 1e-9) / GRID
    counts = np.maximum(np.ceil(side / cell).astype(int), 1) + 1
    axes = [np.linspace(low, high, count) for low, high, count in zip(*box, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    values = np.asarray(jax.jit(jax.vmap(distance))(grid), float)
    strides = np.array([counts[1] * counts[2], counts[2], 1])
    lows = np.stack(np.meshgrid(*[np.arange(count - 1) for count in counts], indexing="ij"), -1).reshape(-1, 3)
    offsets = ((np.arange(8)[:, None] >> np.arange(3)) & 1) @ strides
    tets = ((lows @ strides)[:, None, None] + offsets[_KUHN]).reshape(-1, 4)
    return _cut(grid, values, tets)


def _cut(grid: np.ndarray, values: np.ndarray, tets: np.ndarray) -> Outline:
    inside = values < 0
    order = np.argsort(~inside[tets], axis=1, kind="stable")  # corners inside first
    tets, count = np.take_along_axis(tets, order, 1), inside[tets].sum(1)
    ends = []  # edges whose cuts are the corners of each triangle, (t, 3, 2)
    for number, cuts in _CUTS:
        chosen = tets[count == number]
        ends += [chosen[:, np.array(triangle)] for triangle in cuts]
    pairs = np.sort(np.concatenate(ends).reshape(-1, 2), axis=1)
    edges, numbers = np.unique(pairs, axis=0, return_inverse=True)
    a, b = values[edges].T
    share = (a / np.where(a == b, 1, a - b))[:, None]
    ways = grid[edges]
    points = ways[:, 0] * (1 - share) + ways[:, 1] * share
    triangles = numbers.reshape(-1, 3)
    # Outward is from the corner inside: that of the edge of each triangle's first corner.
    first = np.concatenate(ends)[:, 0]
    outward = grid[first[:, 1]] - grid[first[:, 0]]
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    wrong = np.einsum("ti,ti->t", normal, outward) < 0
    triangles[wrong] = triangles[wrong][:, ::-1]
    return _joined(points, triangles)


def _joined(points: np.ndarray, triangles: np.ndarray) -> Outline:
    """Points within rounding as one, without the triangles that this leaves without area."""
    if not len(triangles):
        return np.zeros((0, 3)), np.zeros((0, 3), int)
    size = max(float(np.ptp(points, axis=0).max(initial=0)), 1e-150)
    _, first, number = np.unique(np.round(points / (1e-9 * size)), axis=0, return_index=True, return_inverse=True)
    corners = number.ravel()[triangles]
    whole = (corners != np.roll(corners, 1, axis=1)).all(1)
    used, numbers = np.unique(corners[whole], return_inverse=True)
    return points[first[used]], numbers.reshape(-1, 3)
