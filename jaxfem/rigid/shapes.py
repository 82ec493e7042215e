"""Shapes of rigid bodies and obstacles: mass properties, distance, and the points that touch others.

Every shape is centred on its own origin and, where it has an axis, lies along z. `distance` takes one point (3,) in the
shape's frame and returns the signed distance to the surface [m], negative inside; contact takes its gradient for the
normal. `features` lists points (k, 3) and the radius of the ball around each that touches others.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import Pytree, static
from jaxfem.rigid.solids import checked_triangles, solid_moments

Array = jax.Array
MassProperties = tuple[float, np.ndarray, np.ndarray]
"""Volume [m^3], centre of mass (3,) [m], inertia per mass about it (3, 3) [m^2]."""


class Sphere(Pytree):
    """A ball of `radius` [m]."""

    radius: Any

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        r = float(self.radius)
        return 4 / 3 * np.pi * r**3, np.zeros(3), 0.4 * r**2 * np.eye(3)

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        return _length(point) - self.radius

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Its centre, with its radius."""
        return np.zeros((1, 3)), np.array([float(self.radius)])


class Box(Pytree):
    """A block with edges of `size` (3,) [m], full lengths."""

    size: Any

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        x, y, z = np.asarray(self.size, float) ** 2
        return float(np.prod(self.size)), np.zeros(3), np.diag([y + z, x + z, x + y]) / 12

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        out = jnp.abs(point) - jnp.asarray(self.size) / 2
        return _length(jnp.maximum(out, 0)) + jnp.minimum(jnp.max(out), 0)

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Its eight corners."""
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), -1).reshape(-1, 3)
        return signs * np.asarray(self.size, float), np.zeros(8)


class Capsule(Pytree):
    """A cylinder with round caps, along z: `length` [m] between the centres of the caps, `radius` [m]."""

    radius: Any
    length: Any

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass: a cylinder and two half balls."""
        r, h = float(self.radius), float(self.length)
        tube, caps = np.pi * r**2 * h, 4 / 3 * np.pi * r**3
        along = tube * r**2 / 2 + caps * 0.4 * r**2
        across = tube * (r**2 / 4 + h**2 / 12) + caps * (0.4 * r**2 + h**2 / 4 + 3 / 8 * h * r)
        return tube + caps, np.zeros(3), np.diag([across, across, along]) / (tube + caps)

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        half = jnp.asarray(self.length) / 2
        along = jnp.clip(point[2], -half, half)
        return _length(point - jnp.stack([0 * along, 0 * along, along])) - self.radius

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Balls along its axis, no further apart than a radius or a quarter of its length."""
        r, h = float(self.radius), float(self.length)
        count = 2 + min(3, int(h / r))
        places = np.zeros((count, 3))
        places[:, 2] = np.linspace(-h / 2, h / 2, count)
        return places, np.full(count, r)


class Cylinder(Pytree):
    """A cylinder along z: `radius` and `length` [m]."""

    radius: Any
    length: Any

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        r, h = float(self.radius), float(self.length)
        across = r**2 / 4 + h**2 / 12
        return np.pi * r**2 * h, np.zeros(3), np.diag([across, across, r**2 / 2])

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        out = jnp.stack([_length(point[:2]) - self.radius, jnp.abs(point[2]) - jnp.asarray(self.length) / 2])
        return _length(jnp.maximum(out, 0)) + jnp.minimum(jnp.max(out), 0)

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Eight points on each rim."""
        turn = np.arange(8) * np.pi / 4
        rim = float(self.radius) * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
        up = np.array([0, 0, float(self.length) / 2])
        return np.concatenate([rim - up, rim + up]), np.zeros(16)


class TriangleMesh(Pytree):
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


class Plane(Pytree):
    """A half-space that bounds others from `point` (3,) [m] along the outward `normal` (3,)."""

    point: Any = (0.0, 0.0, 0.0)
    normal: Any = (0.0, 0.0, 1.0)

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        normal = jnp.asarray(self.normal)
        return jnp.vdot(point - jnp.asarray(self.point), normal / jnp.linalg.norm(normal))


class HeightField(Pytree):
    """Ground z = h(x, y), bilinear over a grid: `heights` (nx, ny) [m] from `origin` (2,) [m] at `spacing` (2,) [m].

    Beyond its edge the ground goes on at the height of the edge. The distance is the height above it times the cosine
    of its slope: exact on a slope, first-order near bumps.
    """

    heights: Any
    spacing: Any
    origin: Any = (0.0, 0.0)

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m], to first order."""
        height, slope = self._ground(point[:2])
        return (point[2] - height) / jnp.sqrt(1 + jnp.vdot(slope, slope))

    def _ground(self, place: Array) -> tuple[Array, Array]:
        heights, spacing = jnp.asarray(self.heights), jnp.asarray(self.spacing)
        cells = jnp.asarray(heights.shape) - 1
        at = (place - jnp.asarray(self.origin)) / spacing
        inside = jnp.clip(at, 0, cells)
        cell = jnp.clip(jnp.floor(jax.lax.stop_gradient(inside)).astype(jnp.int32), 0, cells - 1)
        u, v = inside - cell
        a, b, c, d = (heights[cell[0] + i, cell[1] + j] for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)))
        height = a * (1 - u) * (1 - v) + b * u * (1 - v) + c * (1 - u) * v + d * u * v
        slope = jnp.stack([(b - a) * (1 - v) + (d - c) * v, (c - a) * (1 - u) + (d - b) * u]) / spacing
        return height, jnp.where((at == inside), slope, 0)


class SignedDistance(Pytree):
    """An obstacle given by `function`: a point (3,) [m] and `values` (any pytree) -> signed distance [m], in JAX."""

    function: Callable[..., Array] = static()
    values: Any = ()

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        return self.function(point, self.values)


SOLIDS = (Sphere, Box, Capsule, Cylinder, TriangleMesh)
OBSTACLES = (Plane, Sphere, Box, Capsule, Cylinder, HeightField, SignedDistance)


def _length(vector: Array) -> Array:
    """Euclidean norm, with derivative zero at the origin."""
    square = jnp.vdot(vector, vector)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
