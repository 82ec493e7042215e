"""The solid inside a closed triangulated surface, and its moments; host side."""

from typing import Any, Self

import numpy as np

from jaxfem.inputs import SURFACE_KEYS, Sources, TableLike
from jaxfem.mesh import MeshError
from jaxfem.rigid.shapes.base import MassProperties, Shape


class TriangleMesh(Shape, word="file"):
    """The solid inside a closed surface: `points` (n, 3) [m] and `triangles` (t, 3), turned outward.

    It touches others with its vertices; others touch it only with what `distance` other shapes have. MeshError for a
    surface that is open or not turned outward.
    """

    points: Any
    triangles: Any

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass of the enclosed solid."""
        return solid_moments(*checked_triangles(self.points, self.triangles))

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Its vertices."""
        points = checked_triangles(self.points, self.triangles)[0]
        return points, np.zeros(len(points))

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


def checked_triangles(points: Any, triangles: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and triangles (t, 3) of a closed surface turned outward; MeshError says what is wrong."""
    points, triangles = np.asarray(points, float), np.asarray(triangles)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise MeshError(f"a triangle mesh with points of shape {points.shape}: give finite numbers (n, 3) in m")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.issubdtype(triangles.dtype, np.integer):
        raise MeshError(f"a triangle mesh with triangles of shape {triangles.shape}: give point numbers (t, 3)")
    if triangles.size == 0 or triangles.min() < 0 or triangles.max() >= len(points):
        raise MeshError(f"a triangle mesh names points outside 0 to {len(points) - 1}, or has no triangle")
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    if sorted(map(tuple, edges)) != sorted(map(tuple, edges[:, ::-1])):
        raise MeshError("a triangle mesh of a rigid body is not closed: each edge needs two triangles, turned alike")
    if _signed_volumes(points, triangles).sum() <= 0:
        raise MeshError("a triangle mesh of a rigid body is turned inside out: list each triangle the other way round")
    return points, triangles


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
