"""Contacts as a user declares them: which two things may touch, and how rough and bouncy they are."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from jaxfem.declared.errors import SceneError, checked_number, refuse_traced
from jaxfem.inputs import Count, Flag, Nodes, Number, Text, Vertices, takes
from jaxfem.rigid.shapes.base import Shape, obstacles


@dataclass(frozen=True, eq=False)
class Contact:
    """`a` and `b` do not pass through each other.

    `a`: a body of the scene (the object or its name). `b`: another body, or ground: a `Plane`, a `HeightField`, a
    `SignedDistance` or another shape with a distance, at the world's origin. A soft body touches with the `nodes` of
    its surface, or a selection ("all": those inside too, which come through ground where a body is pressed flat; where
    its weight or its speed at the start will do that, ground has rows for all without being asked), or in their place
    with the vertices `surface` (q, 3) [m] of a finer surface embedded in it, given where they are at the start (True:
    those of the surface that the body declares): each moves with the element that holds it or is nearest to it. Of a
    surface finer than the mesh at most `per_node` vertices a node take part in a step, those nearest to b: more say
    much the same, and take longer. A rigid body touches with what its shape's `features` lists, with its
    `segments` and its `circles`; their sharp points touch the faces of soft bodies too.
    `faces`: whether the triangles of soft `a` touch as well, for rigid `b` or ground that could slip between a's nodes;
    where b is thinner than the widest triangle if nothing is said. With faces=True alone, for soft b and a body that
    touches itself: points of edges between nodes, of both; `build` warns where two may pass without.
    A soft body that is both `a` and `b` touches itself: the surface patch of `nodes` meets that of the nodes `against`,
    both ways; they share no node.
    Two soft bodies touch both ways, but only a's points against b with `nodes` or `surface`.
    `friction`: Coulomb's coefficient; 0 makes no rows for it. `cone`: friction holds alike in all directions; without
    it up to 1.41 times as much between the two that its rows have. `restitution`: speed after an impact over speed
    before.
    `margin` [m]: pairs further apart than this, beyond what they approach within the step, take no part (a twentieth of
    a's size without it). `separation` [m/s]: at most so fast are partners moved apart that are inside each other (a's
    size in a second without it); what is deep keeps none of that speed. Raises SceneError.
    """

    a: Any = field(metadata=takes(Text()))
    b: Any = field(metadata=takes(Text()))
    friction: float = field(default=0.5, metadata=takes(Number()))
    restitution: float = field(default=0.0, metadata=takes(Number()))
    margin: float | None = field(default=None, metadata=takes(Number("m", positive=True, optional=True)))
    separation: float | None = field(default=None, metadata=takes(Number("m/s", positive=True, optional=True)))
    nodes: Any = field(default=None, metadata=takes(Nodes(optional=True)))
    surface: Any = field(default=None, metadata=takes(Vertices(optional=True)))
    name: str | None = field(default=None, metadata=takes(Text(optional=True)))
    against: Any = field(default=None, metadata=takes(Nodes(optional=True)))
    cone: bool = field(default=False, metadata=takes(Flag()))
    faces: bool | None = field(default=None, metadata=takes(Flag(optional=True)))
    per_node: int = field(default=2, metadata=takes(Count()))

    def __post_init__(self) -> None:
        refuse_traced(self)
        if self.a is None or self.b is None:
            raise SceneError(f'"{self.label}" needs two partners; ground is a Plane, a HeightField or a SignedDistance')
        if isinstance(self.b, Shape):
            self._check_ground(self.b)
        checked_number(f'friction of "{self.label}"', self.friction, low=0)
        checked_number(f'restitution of "{self.label}"', self.restitution, low=0, high=1)
        if self.nodes is not None and self.surface is not None:
            raise SceneError(f'"{self.label}" has both nodes and surface: give the points that touch once')
        if flaw := Count().flaw(self.per_node):
            raise SceneError(f'per_node of "{self.label}" is {self.per_node!r}: {flaw}')
        for what in ("margin", "separation"):
            if getattr(self, what) is not None:
                checked_number(f'{what} of "{self.label}"', getattr(self, what), low=0, open_low=True)

    @property
    def label(self) -> str:
        """The contact's name in messages."""
        return self.name or "Contact"

    def unused(self) -> Iterator[str]:
        """What it has that changes nothing, in words."""
        if self.cone and not self.friction:
            yield "a cone and no friction"
        if self.per_node != 2 and self.surface is None:
            yield "per_node and no surface"
        if self.against is not None and isinstance(self.b, Shape):
            yield "a patch `against` beside ground"
        if self.faces and isinstance(self.b, Shape) and self.b.flat:
            yield "faces on flat ground"

    def _check_ground(self, ground: Shape) -> None:
        if not ground.is_obstacle():
            known = ", ".join(each.__name__ for each in obstacles())
            raise SceneError(f'"{self.label}" has a {type(ground).__name__} for ground; ground is one of {known}')
        if flaw := ground.flaw(f"the ground of {self.label}"):
            raise SceneError(flaw)
