"""The solid inside a closed triangulated surface: its moments and what of it touches; host side."""

from functools import lru_cache
from typing import Any, ClassVar, Self

import jax
import numpy as np

from jaxfem.inputs import SURFACE_KEYS, Sources, TableLike
from jaxfem.mesh import MeshError
from jaxfem.rigid.shapes.base import MassProperties, Shape
from jaxfem.rigid.shapes.nearest import NearestTriangles, nearest_triangles
from jaxfem.rigid.shapes.outline import Outline

Array = jax.Array

BLUNT = 0.02
"""Sine of the angle between two faces up to which their common edge is none: no other body can touch it alone."""


class TriangleMesh(Shape, word="file"):
    """The solid inside a closed surface: `points` (n, 3) [m] and `triangles` (t, 3), turned outward.

    It touches others with its edges that are not blunt or hollow, and their vertices; others touch its faces. As ground
    it may be open, its triangles turned upwards. MeshError for a body's surface that is open or not turned outward.
    """

    points: Any
    triangles: Any
    shared: ClassVar[bool] = True
    convex: ClassVar[bool] = False

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        return self.measured().distance(point)

    def measured(self, reach: float = 0.0) -> NearestTriangles:
        """Its triangles, with a grid that says which may be nearest."""
        points, triangles = numbered_triangles(self.points, self.triangles)
        return _ready(points.tobytes(), triangles.astype(np.int64).tobytes())

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass of the enclosed solid."""
        return solid_moments(*checked_triangles(self.points, self.triangles))

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """The vertices of its edges."""
        points, triangles = numbered_triangles(self.points, self.triangles)
        edges = sharp_edges(points, triangles)
        return points[np.unique(edges)], np.zeros(len(np.unique(edges)))

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Its edges."""
        points, triangles = numbered_triangles(self.points, self.triangles)
        ends = points[sharp_edges(points, triangles)]
        return ends, np.zeros(len(ends))

    def outline(self, box: np.ndarray) -> Outline:
        """The surface itself."""
        return numbered_triangles(self.points, self.triangles)

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        """It comes from a file of its own, in metres once multiplied by `scale`."""
        return SURFACE_KEYS

    @classmethod
    def example(cls) -> str:
        """A table for messages."""
        return "{ file = 'part.stl' }"

    @classmethod
    def read(cls, table: TableLike, sources: Sources) -> Self:
        """The surface that the file holds."""
        return cls(*sources.surface(table))


def numbered_triangles(points: Any, triangles: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and triangles (t, 3) of any surface; MeshError says what is wrong."""
    points, triangles = np.asarray(points, float), np.asarray(triangles)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise MeshError(f"a triangle mesh with points of shape {points.shape}: give finite numbers (n, 3) in m")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.issubdtype(triangles.dtype, np.integer):
        raise MeshError(f"a triangle mesh with triangles of shape {triangles.shape}: give point numbers (t, 3)")
    if triangles.size == 0 or triangles.min() < 0 or triangles.max() >= len(points):
        raise MeshError(f"a triangle mesh names points outside 0 to {len(points) - 1}, or has no triangle")
    return points, triangles


def checked_triangles(points: Any, triangles: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and triangles (t, 3) of a closed surface turned outward; MeshError says what is wrong."""
    points, triangles = numbered_triangles(points, triangles)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    if sorted(map(tuple, edges)) != sorted(map(tuple, edges[:, ::-1])):
        raise MeshError("a triangle mesh of a rigid body is not closed: each edge needs two triangles, turned alike")
    if _signed_volumes(points, triangles).sum() <= 0:
        raise MeshError("a triangle mesh of a rigid body is turned inside out: list each triangle the other way round")
    return points, triangles


def sharp_edges(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Ends (k, 2), as numbers of points, of edges where the surface turns away from them, and of its border."""
    corners = points[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    number = np.arange(len(triangles))
    # Each edge as it runs in its triangle, with the corner across it.
    run = np.concatenate([triangles[:, [0, 1, 2]], triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]])
    own = np.tile(number, 3)
    across = {(b, a): c for a, b, c in run.tolist()}
    found = []
    for (a, b, _), triangle in zip(run.tolist(), own.tolist(), strict=True):
        other = across.get((a, b))
        if other is None:
            found.append((a, b))
        elif a < b:
            along, way = points[b] - points[a], points[other] - points[a]
            height = np.linalg.norm(np.cross(along, way)) / np.maximum(np.linalg.norm(along), 1e-300)
            if way @ normal[triangle] < -BLUNT * height:
                found.append((a, b))
    return np.array(found, int).reshape(-1, 2)


@lru_cache(maxsize=16)
def _ready(points: bytes, triangles: bytes) -> NearestTriangles:
    made = np.frombuffer(points).reshape(-1, 3), np.frombuffer(triangles, np.int64).reshape(-1, 3)
    return nearest_triangles(*made)


def solid_moments(points: np.ndarray, triangles: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume [m^3], centre of mass (3,) [m] and inertia per mass about it (3, 3) [m^2].

    Sums over the tetrahedra from the origin to each triangle: with corners a, b, c and s = a + b + c,
    int x dV = V s / 4 and int x x' dV = V (s s' + a a' + b b' + c c') / 20.
    """
    volumes = _signed_volumes(points, triangles)
    corners = points[triangles]
    total, sums = volumes.sum(), corners.sum(1)
    center = np.einsum("t,ti->i", volumes, sums) / 4 / total
    second = np.einsum("t,ti,tj->ij", volumes, sums, sums) + np.einsum("t,tai,taj->ij", volumes, corners, corners)
    covariance = second / 20 / total - np.outer(center, center)
    return float(total), center, np.trace(covariance) * np.eye(3) - covariance


def _signed_volumes(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    volumes: np.ndarray = np.einsum("ti,ti->t", a, np.cross(b, c)) / 6
    return volumes
