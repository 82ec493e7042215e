"""A joint that holds a distance."""

from collections.abc import Iterator
from dataclasses import field
from typing import Any

import numpy as np

from jaxfem.declared.errors import SceneError, checked_number, checked_vector
from jaxfem.declared.joints.base import Attachments, Joint, Part
from jaxfem.inputs import Number, Vector, takes
from jaxfem.rows.coordinates import Distance, LengthValues, Separation

ROUNDED = 1e-3
"""Of a length: what is no more is rounding, or laid by hand."""


class DistanceJoint(Joint, kind="distance", variants={"rope": {"rope": True}}):
    """The distance between `anchor` of a and `anchor_b` of b is `length` [m] (that of the start without it).

    `rope`: at most that length. In a rope only tension acts.
    """

    anchor: Any = field(default=None, metadata=takes(Vector("m")))
    anchor_b: Any = field(default=None, metadata=takes(Vector("m")))
    length: float | None = field(default=None, metadata=takes(Number("m", optional=True)))
    rope: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        a = checked_vector(f'anchor of "{self.label}"', self.anchor)
        b = checked_vector(f'anchor_b of "{self.label}"', self.anchor_b)
        if self.length is not None:
            checked_number(f'length of "{self.label}"', self.length, low=0)
        if np.linalg.norm(b - a) == 0 and not self.rope:
            raise SceneError(f'"{self.label}" joins two points at one place: use a BallJoint, or a rope')

    @property
    def start_length(self) -> float:
        """The distance at the start [m]."""
        return float(np.linalg.norm(np.asarray(self.anchor_b, float) - np.asarray(self.anchor, float)))

    @property
    def rest_length(self) -> float:
        """The length to hold [m]."""
        return self.start_length if self.length is None else float(self.length)

    def open_by(self) -> tuple[float, str]:
        """A length that is not that of the start; of a rope, one that is shorter. Springs may be strained."""
        longer = self.start_length - self.rest_length
        gap = max(longer, 0.0) if self.rope else abs(longer)
        laid = gap <= ROUNDED * max(self.start_length, self.rest_length)
        return (0.0 if laid or self.compliance else gap), "m"

    def parts(self, bodies: Attachments, where: str) -> Iterator[Part]:
        """One row along the line between the points."""
        ends = bodies.point(self.a, self.anchor, where), bodies.point(self.b, self.anchor_b, where)
        values = LengthValues(self.rest_length, float(self.compliance), float(self.damping))
        yield Part("rope" if self.rope else "distance", Distance(Separation(*ends), rope=self.rope), values)
