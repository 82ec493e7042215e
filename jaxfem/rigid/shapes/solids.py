"""Solids of simple form."""

from dataclasses import field
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.inputs import Number, Vector, takes
from jaxfem.rigid.shapes.base import MassProperties, Shape, between, length, outside
from jaxfem.rigid.shapes.outline import Outline, block, revolved

Array = jax.Array
LENGTH = Number("m", positive=True)


class Sphere(Shape, word="sphere"):
    """A ball of `radius` [m]."""

    radius: Any = field(metadata=takes(LENGTH))
    swept: ClassVar[bool] = True

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

    def outline(self, box: np.ndarray) -> Outline:
        """Rings from pole to pole."""
        turn = np.linspace(-np.pi / 2, np.pi / 2, 17)
        return revolved(float(self.radius) * np.cos(turn), float(self.radius) * np.sin(turn))


class Box(Shape, word="box"):
    """A block with edges of `size` (3,) [m], full lengths."""

    size: Any = field(metadata=takes(Vector("m", positive=True)))
    crease: ClassVar[float] = 0.9999

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        x, y, z = np.asarray(self.size, float) ** 2
        return float(np.prod(self.size)), np.zeros(3), np.diag([y + z, x + z, x + y]) / 12

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        return outside(jnp.abs(point) - jnp.asarray(self.size) / 2)

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Its eight corners."""
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), -1).reshape(-1, 3)
        return signs * np.asarray(self.size, float), np.zeros(8)

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Its twelve edges."""
        half, sharp = np.asarray(self.size, float) / 2, np.zeros(12)
        ends = [
            [np.insert([i, j], axis, side) for side in (-1, 1)] for axis in range(3) for i in (-1, 1) for j in (-1, 1)
        ]
        return np.array(ends, float) * half, sharp

    def edges(self) -> np.ndarray:
        """Halves of its size."""
        return np.asarray(self.size, float) / 2

    def outline(self, box: np.ndarray) -> Outline:
        """Its faces."""
        return block(-self.edges(), self.edges())


class Capsule(Shape, word="capsule"):
    """A cylinder with round caps, along z: `length` [m] between the centres of the caps, `radius` [m]."""

    radius: Any = field(metadata=takes(LENGTH))
    length: Any = field(metadata=takes(LENGTH))
    swept: ClassVar[bool] = True

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
        along = between(point[2], -half, half)
        gap: Array = length(point - jnp.stack([0 * along, 0 * along, along])) - self.radius
        return gap

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """The balls at its ends."""
        return _axis(self.length), np.full(2, float(self.radius))

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Its axis, with the ball between."""
        return _axis(self.length)[None], np.array([float(self.radius)])

    def outline(self, box: np.ndarray) -> Outline:
        """Two halves of a ball, and the side between."""
        turn, r, half = np.linspace(-np.pi / 2, 0, 9), float(self.radius), float(self.length) / 2
        low = r * np.cos(turn), r * np.sin(turn) - half
        return revolved(np.concatenate([low[0], low[0][::-1]]), np.concatenate([low[1], -low[1][::-1]]))


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
        return outside(jnp.stack([length(point[:2]) - self.radius, jnp.abs(point[2]) - jnp.asarray(self.length) / 2]))

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """None: it touches with rims and side."""
        return np.zeros((0, 3)), np.zeros(0)

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Its axis: between its ends a ball swept along it is the side."""
        return _axis(self.length)[None], np.array([float(self.radius)])

    def circles(self) -> np.ndarray:
        """Both rims."""
        r = float(self.radius)
        return np.array([[end, (r, 0, 0), (0, r, 0)] for end in _axis(self.length)])

    def outline(self, box: np.ndarray) -> Outline:
        """Side and ends."""
        half = float(self.length) / 2
        return revolved([float(self.radius)] * 2, [-half, half])


def _axis(length: Any) -> np.ndarray:
    """Ends (2, 3) of an axis along z."""
    return np.array([[0, 0, -0.5], [0, 0, 0.5]]) * float(length)
