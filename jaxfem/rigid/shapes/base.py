"""What a shape of contact is: a class that says what it can do, and registers itself with the word of scene files.

Every shape is centred on its own origin and, where it has an axis, lies along z. What it has decides what it can be:
* `distance(point)`: signed distance [m] of one point (3,) in the shape's frame, negative inside, in JAX; contact takes
  its gradient for the normal. Others can touch the shape, and it can be ground.
* `mass_properties()` and `features()`, on the host: it can be a rigid body. `features` lists the points (k, 3) [m] with
  which it touches others, and the radius (k,) [m] of the ball around each.
* `segments()` and `circles()`, on the host: straight edges, axes along which a ball is swept, and rims, which touch
  others with whichever of their points is nearest; a shape that has none leaves them out.
A subclass may live anywhere, also outside the package.
"""

from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import FLAG, NUMBER, flaw_of, still_says
from jaxfem.inputs import Sources, TableLike, inputs_of, read_fields
from jaxfem.pytrees import Pytree
from jaxfem.registry import Registry
from jaxfem.rigid.shapes.outline import Outline, block, level_surface
from jaxfem.tensors import inner

Array = jax.Array
MassProperties = tuple[float, np.ndarray, np.ndarray]
"""Volume [m^3], centre of mass (3,) [m], inertia per mass about it (3, 3) [m^2]."""


class Shape(Pytree):
    """Base class. `word`: what scene files call it, `leading`: the field whose value stands at the word, the first
    without it; a shape without a word is for Python alone."""

    word: ClassVar[str | None] = None
    leading: ClassVar[str | None] = None
    shared: ClassVar[bool] = False
    """Whether all pairs of a contact share one copy of its values: large ones, or a function."""
    flat: ClassVar[bool] = False
    """Whether its distance is linear: of a segment, only an end can be nearest."""
    crease: ClassVar[float] = 0.9
    """Cosine between normals at places near each other below which there is an edge in between: near 1 where all its
    faces are flat."""
    convex: ClassVar[bool] = True
    """Whether the distance from it has no more than one least value along a straight line."""
    swept: ClassVar[bool] = False
    """Whether its balls, and those along its segments, are all of it: a convex partner's curves tell nothing more."""

    def __init_subclass__(cls, word: str | None = None, leading: str | None = None, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.word, cls.leading = word, leading
        for flag in ("flat", "swept"):
            if not still_says(cls, flag, "distance"):
                setattr(cls, flag, False)
        if word is None:
            return
        if not (cls.is_solid() or cls.is_obstacle()):
            raise TypeError(f"{cls.__name__} has neither `distance` nor `mass_properties` and `features`: define some")
        if not inputs_of(cls) and getattr(cls.read, "__func__", None) is getattr(Shape.read, "__func__", None):
            raise TypeError(f"{cls.__name__} says not what its fields take: give them metadata=takes(...)")
        flags = dict.fromkeys(("shared", "flat", "convex", "swept"), FLAG)
        if flaw := flaw_of(cls, {**flags, "crease": NUMBER}):
            raise TypeError(f"{cls.__name__} has {flaw}")
        if leading is not None and leading not in inputs_of(cls):
            raise TypeError(
                f"{cls.__name__} leads with {leading!r}, which is none of its fields {', '.join(inputs_of(cls))}"
            )
        SHAPES.add(word, cls)

    @classmethod
    def is_solid(cls) -> bool:
        """Whether it can be a rigid body."""
        return cls.mass_properties is not Shape.mass_properties and cls.has_points()

    @classmethod
    def is_obstacle(cls) -> bool:
        """Whether points of others can touch it, so that it can be ground."""
        return cls.distance is not Shape.distance

    def distance(self, point: Array) -> Array:
        """Signed distance of a point (3,) [m]."""
        raise NotImplementedError(f"others cannot touch a {type(self).__name__}")

    @classmethod
    def has_points(cls) -> bool:
        """Whether it touches others with points of its own."""
        return cls.features is not Shape.features

    def measured(self, reach: float = 0.0) -> Any:
        """What contact takes distances from, a pytree with `distance`: itself, or what is made of it once, on the host.
        `reach` [m]: radius of the largest ball that touches it."""
        return self

    def mass_properties(self) -> MassProperties:
        """Volume, centre, inertia per mass."""
        raise NotImplementedError(f"a {type(self).__name__} is no rigid body")

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Points (k, 3) [m] that touch others, and the radius (k,) [m] of the ball around each."""
        raise NotImplementedError(f"a {type(self).__name__} is no rigid body")

    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (k, 2, 3) [m] of segments that touch others between their ends, and the radius (k,) [m] of the ball
        swept along each; the ends belong to `features`."""
        return np.zeros((0, 2, 3)), np.zeros(0)

    def circles(self) -> np.ndarray:
        """Rims that touch others, (k, 3, 3) [m]: the centre of each and two of its radii, at right angles."""
        return np.zeros((0, 3, 3))

    def extent(self) -> np.ndarray:
        """Points (k, 3) [m] whose bounding box is that of a solid, or a little larger."""
        balls, radius = self.features()
        ends, swept = self.segments()
        rims = self.circles()
        around = [balls + side * radius[:, None] for side in (-1, 1)]
        along = [(ends + side * swept[:, None, None]).reshape(-1, 3) for side in (-1, 1)]
        reach = np.linalg.norm(rims[:, 1:], axis=1)
        return np.concatenate([*around, *along, rims[:, 0] - reach, rims[:, 0] + reach])

    def outline(self, box: np.ndarray) -> Outline:
        """Triangles to look at, in the shape's frame, within a `box` (2, 3) [m] where the shape is endless, or in a
        larger one where it has no part of it: where its distance is 0, or its bounding box where it has none."""
        if self.is_solid():
            extent = self.extent()
            if not len(extent):
                return np.zeros((0, 3)), np.zeros((0, 3), int)
            box = np.stack([extent.min(0), extent.max(0)])
            if not self.is_obstacle():
                return block(*box)
            box = box + 0.05 * np.ptp(box, axis=0).max() * np.array([[-1.0], [1.0]])
        found = level_surface(self.distance, box)
        away = 0.0 if len(found[1]) else float(np.abs(self.distance(box.mean(0))))
        if not 0 < away < np.inf:
            return found
        return level_surface(self.distance, box + 1.1 * away * np.array([[-1.0], [1.0]]))  # seen from far off

    def thickness(self) -> float:
        """How wide [m] the gap between two points is through which it could slip at least, as its bounding box says;
        infinite for what is no solid."""
        return float(np.ptp(self.extent(), axis=0).min()) if self.is_solid() else np.inf

    def edges(self) -> np.ndarray | None:
        """Halves (3,) [m] of the sizes of the block whose edges touch those of others; None for what has none."""
        return None

    def flaw(self, label: str) -> str:
        """What is wrong with its values, and what to do; empty where nothing is. `label`: whose shape it is."""
        for name, each in inputs_of(self).items():
            if flaw := each.flaw(getattr(self, name)):
                return f'{name} of "{label}" is {np.asarray(getattr(self, name)).tolist()}; {flaw}'
        return ""

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        """Keys of its table in a scene file: its word in place of the leading field, then the other fields."""
        fields = tuple(inputs_of(cls))
        leading = cls.leading or fields[0]
        return (str(cls.word), *(name for name in fields if name != leading))

    @classmethod
    def example(cls) -> str:
        """A table for messages."""
        fields = inputs_of(cls)
        return f"{{ {cls.word} = {fields[cls.leading or next(iter(fields))].example} }}"

    @classmethod
    def read(cls, table: TableLike, sources: Sources) -> Self:
        """The shape that such a table describes."""
        leading = cls.leading or next(iter(inputs_of(cls)))
        return cls(**read_fields(cls, table, sources, keys={leading: str(cls.word)}))


SHAPES: Registry[Shape] = Registry("shape")
"""All shapes by their words."""


def solids() -> list[type[Shape]]:
    """The registered shapes that can be rigid bodies."""
    return [each for each in SHAPES.classes() if each.is_solid()]


def obstacles() -> list[type[Shape]]:
    """The registered shapes that can be ground."""
    return [each for each in SHAPES.classes() if each.is_obstacle()]


def length(vector: Array) -> Array:
    """Euclidean norm, with derivative zero at the origin."""
    square = inner(vector, vector)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def outside(out: Array) -> Array:
    """Signed distance of a convex solid that reaches to `out` (k,) [m] along directions at right angles: negative where
    inside. The normal is that of a face also on it, where maxima would halve it.

    Written with selections: the derivative of a maximum compares it with what it was taken of, and compiled code may
    round the two differently.
    """
    inside = out[0]
    for each in out[1:]:
        inside = jnp.where(each > inside, each, inside)
    return length(jnp.where(out > 0, out, 0)) + jnp.where(inside <= 0, inside, 0)


def between(value: Array, low: Any, high: Any) -> Array:
    """A number between two others, by selections too."""
    return jnp.where(value < low, low, jnp.where(value > high, high, value))
