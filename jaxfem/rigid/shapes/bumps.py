"""Bumps of ground over a grid: its ridges and peaks, which touch others, and its exact distance for balls."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import Pytree, static
from jaxfem.rigid.shapes.nearest import square_distances
from jaxfem.tensors import inner, matmul

Array = jax.Array

BLUNT = 0.02
"""Change of slope up to which neighbouring faces are one."""
LEVEL = 1e-9  # of all heights: a crease below is rounding
WIDEST = 6
"""Cells to each side of a place that are looked at for the nearest face."""
CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])


class NearFaces(Pytree):
    """Distance to the faces around: each cell is four triangles about the mean of its corners. `ground`: a pytree with
    `heights`, `spacing`, `origin`, `ground` and `distance`, which serves beyond `window` cells."""

    ground: Any
    window: int = static()

    @classmethod
    def around(cls, ground: Any, reach: float) -> "NearFaces":
        """For balls of radius up to `reach` [m], and a little further."""
        return cls(ground, min(WIDEST, math.ceil(1.3 * reach / float(np.min(ground.spacing)))))

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        spacing = jnp.asarray(self.ground.spacing)
        above = point[2] - self.ground.ground(point[:2])[0]
        triangles = self._triangles(jax.lax.stop_gradient(point), spacing)
        squares = square_distances(jnp, *jax.lax.stop_gradient((point, triangles)))[0]
        nearest = triangles[jnp.argmin(squares)]
        way = point - matmul(square_distances(jnp, point, nearest)[1], nearest)
        square = inner(way, way)
        near = (square > 0) & (square < (self.window * spacing.min()) ** 2)
        length = jnp.sqrt(jnp.where(near, square, 1))
        return jnp.where(near, jnp.where(above < 0, -length, length), self.ground.distance(point))

    def _triangles(self, point: Array, spacing: Array) -> Array:
        """Triangles (4 cells, 3, 3) of the cells around a point."""
        heights, origin = jnp.asarray(self.ground.heights), jnp.asarray(self.ground.origin)
        side = np.arange(-self.window, self.window + 1)
        cells = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 1, 2)
        index = jnp.floor((point[:2] - origin) / spacing).astype(jnp.int32) + cells + CORNERS
        inside = jnp.clip(index, 0, jnp.array(heights.shape) - 1)
        places = jnp.concatenate([origin + index * spacing, heights[inside[..., 0], inside[..., 1], None]], -1)
        middle = jnp.broadcast_to(jnp.mean(places, 1, keepdims=True), places.shape)
        return jnp.stack([places, jnp.roll(places, -1, 1), middle], 2).reshape(-1, 3, 3)


def creases(heights: Any) -> tuple[np.ndarray, np.ndarray]:
    """How far (nx, ny) each grid point stands above the mean of its neighbours along x, and along y; [m]."""
    h = np.asarray(heights, float)
    wide = np.pad(h, 1, mode="edge")
    return h - (wide[2:, 1:-1] + wide[:-2, 1:-1]) / 2, h - (wide[1:-1, 2:] + wide[1:-1, :-2]) / 2


def ridge_points(heights: Any, spacing: Any, origin: Any) -> np.ndarray:
    """Grid points (k, 3) [m] that stand above their neighbours along x or y."""
    along_x, along_y = creases(heights)
    dx, dy = np.asarray(spacing, float)
    return _places(np.argwhere((along_x > BLUNT * dx / 2) | (along_y > BLUNT * dy / 2)), heights, spacing, origin)


def ridges(heights: Any, spacing: Any, origin: Any) -> np.ndarray:
    """Ends (k, 2, 3) [m] of edges of the grid across which the ground falls away to both sides."""
    found = []
    for axis, across in enumerate(creases(heights)[::-1]):
        high = across > BLUNT * np.asarray(spacing, float)[1 - axis] / 2
        both = high[:-1] & high[1:] if axis == 0 else high[:, :-1] & high[:, 1:]
        first = np.argwhere(both)
        second = first + np.eye(2, dtype=int)[axis]
        found.append(np.stack([_places(each, heights, spacing, origin) for each in (first, second)], 1))
    return np.concatenate(found)


def _places(index: np.ndarray, heights: Any, spacing: Any, origin: Any) -> np.ndarray:
    h = np.asarray(heights, float)
    flat = np.asarray(origin, float) + index * np.asarray(spacing, float)
    return np.column_stack([flat, h[index[:, 0], index[:, 1]]])
