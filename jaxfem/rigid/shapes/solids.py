"""Solids of simple form."""

from dataclasses import field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.inputs import Number, Vector, takes
from jaxfem.rigid.shapes.base import MassProperties, Shape, length

Array = jax.Array
LENGTH = Number("m", positive=True)


class Sphere(Shape, word="sphere"):
    """A ball of `radius` [m]."""

    radius: Any = field(metadata=takes(LENGTH))

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        r = float(self.radius)
        return 4 / 3 * np.pi * r**3, np.zeros(3), 0.4 * r**2 * np.eye(3)

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        gap: Array = length(point) - self.radius
        return gap

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Its centre, with its radius."""
        return np.zeros((1, 3)), np.array([float(self.radius)])


class Box(Shape, word="box"):
    """A block with edges of `size` (3,) [m], full lengths."""

    size: Any = field(metadata=takes(Vector("m", positive=True)))

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        x, y, z = np.asarray(self.size, float) ** 2
        return float(np.prod(self.size)), np.zeros(3), np.diag([y + z, x + z, x + y]) / 12

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        out = jnp.abs(point) - jnp.asarray(self.size) / 2
        return length(jnp.maximum(out, 0)) + jnp.minimum(jnp.max(out), 0)

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Its eight corners."""
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), -1).reshape(-1, 3)
        return signs * np.asarray(self.size, float), np.zeros(8)

    def edges(self) -> np.ndarray:
        """Halves of its size."""
        return np.asarray(self.size, float) / 2


class Capsule(Shape, word="capsule"):
    """A cylinder with round caps, along z: `length` [m] between the centres of the caps, `radius` [m]."""

    radius: Any = field(metadata=takes(LENGTH))
    length: Any = field(metadata=takes(LENGTH))

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
        gap: Array = length(point - jnp.stack([0 * along, 0 * along, along])) - self.radius
        return gap

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Balls along its axis, no further apart than a radius or a quarter of its length."""
        r, h = float(self.radius), float(self.length)
        count = 2 + min(3, int(h / r))
        places = np.zeros((count, 3))
        places[:, 2] = np.linspace(-h / 2, h / 2, count)
        return places, np.full(count, r)


class Cylinder(Shape, word="cylinder"):
    """A cylinder along z: `radius` and `length` [m]."""

    radius: Any = field(metadata=takes(LENGTH))
    length: Any = field(metadata=takes(LENGTH))

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        r, h = float(self.radius), float(self.length)
        across = r**2 / 4 + h**2 / 12
        return np.pi * r**2 * h, np.zeros(3), np.diag([across, across, r**2 / 2])

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        out = jnp.stack([length(point[:2]) - self.radius, jnp.abs(point[2]) - jnp.asarray(self.length) / 2])
        return length(jnp.maximum(out, 0)) + jnp.minimum(jnp.max(out), 0)

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Eight points on each rim."""
        turn = np.arange(8) * np.pi / 4
        rim = float(self.radius) * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
        up = np.array([0, 0, float(self.length) / 2])
        return np.concatenate([rim - up, rim + up]), np.zeros(16)
