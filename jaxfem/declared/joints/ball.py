"""A joint that holds a point."""

from collections.abc import Iterator
from dataclasses import field
from typing import Any

from jaxfem.declared.errors import checked_vector
from jaxfem.declared.joints.base import Attachments, Joint, Part
from jaxfem.inputs import Vector, takes
from jaxfem.rows.locks import PointLock


class BallJoint(Joint, kind="ball"):
    """A point of `a` and a point of `b` coincide: `anchor` (3,) [m], or `anchor` of a and `anchor_b` of b."""

    anchor: Any = field(default=None, metadata=takes(Vector("m")))
    anchor_b: Any = field(default=None, metadata=takes(Vector("m", optional=True)))

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector(f'anchor of "{self.label}"', self.anchor)
        if self.anchor_b is not None:
            checked_vector(f'anchor_b of "{self.label}"', self.anchor_b)

    def parts(self, bodies: Attachments, where: str) -> Iterator[Part]:
        """A lock of the two points."""
        other = self.anchor if self.anchor_b is None else self.anchor_b
        ends = bodies.point(self.a, self.anchor, where), bodies.point(self.b, other, where)
        yield Part("point", PointLock(*ends), self.softness)
