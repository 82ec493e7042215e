"""Ground: what bounds others and is no body."""

from collections.abc import Callable
from dataclasses import field
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.inputs import Direction, Grid, Vector, takes
from jaxfem.pytrees import static
from jaxfem.rigid.shapes.base import Shape
from jaxfem.rigid.shapes.bumps import LEVEL, NearFaces, creases, ridge_points, ridges
from jaxfem.rigid.shapes.outline import Outline, gridded
from jaxfem.tensors import inner

Array = jax.Array


class Plane(Shape, word="plane", leading="normal"):
    """A half-space that bounds others from `point` (3,) [m] along the outward `normal` (3,)."""

    point: Any = field(default=(0.0, 0.0, 0.0), metadata=takes(Vector("m")))
    normal: Any = field(default=(0.0, 0.0, 1.0), metadata=takes(Direction()))
    flat: ClassVar[bool] = True

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        normal = jnp.asarray(self.normal)
        return inner(point - jnp.asarray(self.point), normal / jnp.linalg.norm(normal))

    def outline(self, box: np.ndarray) -> Outline:
        """A square under the middle of the box, as wide as that is long."""
        normal = np.asarray(self.normal, float) / np.linalg.norm(self.normal)
        middle = box.mean(0) - normal * (normal @ (box.mean(0) - np.asarray(self.point, float)))
        first = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
        first /= np.linalg.norm(first)
        along = np.linspace(-0.5, 0.5, 2) * np.linalg.norm(np.ptp(box, axis=0))
        across = np.cross(normal, first)
        return gridded(middle + along[:, None, None] * first + along[None, :, None] * across)


class HeightField(Shape, word="heights"):
    """Ground z = h(x, y), bilinear over a grid: `heights` (nx, ny) [m] from `origin` (2,) [m] at `spacing` (2,) [m].

    Beyond its edge the ground goes on at the height of the edge. The distance is the height above it times the cosine
    of its slope: exact on a slope, first-order near bumps; exact everywhere for balls (see `bumps.py`). Ridges and
    peaks touch others too.
    """

    heights: Any = field(metadata=takes(Grid("m", "heights")))
    spacing: Any = field(metadata=takes(Vector("m", 2, positive=True)))
    origin: Any = field(default=(0.0, 0.0), metadata=takes(Vector("m", 2)))
    shared: ClassVar[bool] = True
    convex: ClassVar[bool] = False

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m], to first order."""
        height, slope = self.ground(point[:2])
        return (point[2] - height) / jnp.sqrt(1 + inner(slope, slope))

    def measured(self, reach: float = 0.0) -> Any:
        """Itself for points; for balls the distance of the faces around."""
        bumpy = max((np.abs(each).max(initial=0.0) for each in creases(self.heights)), default=0.0)
        return self if reach == 0 or bumpy <= LEVEL * np.ptp(self.heights) else NearFaces.around(self, reach)

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Its peaks, and the points of its ridges."""
        places = ridge_points(self.heights, self.spacing, self.origin)
        return places, np.zeros(len(places))

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Its ridges, as far as they run along the grid."""
        ends = ridges(self.heights, self.spacing, self.origin)
        return ends, np.zeros(len(ends))

    def thickness(self) -> float:
        """The spacing where it is not even."""
        return float(np.min(self.spacing)) if len(self.features()[1]) else np.inf

    def outline(self, box: np.ndarray) -> Outline:
        """Its grid."""
        heights = np.asarray(self.heights, float)
        axes = [o + s * np.arange(n) for o, s, n in zip(self.origin, self.spacing, heights.shape, strict=True)]
        return gridded(np.stack([*np.meshgrid(*axes, indexing="ij"), heights], -1))

    def ground(self, place: Array) -> tuple[Array, Array]:
        """Height [m] and slope (2,) at a place (2,) [m]."""
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


class SignedDistance(Shape):
    """An obstacle given by `function`: a point (3,) [m] and `values` (any pytree) -> signed distance [m], in JAX."""

    function: Callable[..., Array] = static()
    values: Any = ()
    shared: ClassVar[bool] = True
    convex: ClassVar[bool] = False

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        return self.function(point, self.values)
