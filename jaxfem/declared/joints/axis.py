"""What joints with one free coordinate along an axis share: limits and a motor on it."""

from collections.abc import Iterator
from dataclasses import field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from jaxfem.declared.errors import SceneError, checked_direction, checked_vector
from jaxfem.declared.joints.base import Attachments, Joint, Part, frame_along
from jaxfem.declared.joints.motor import Motor
from jaxfem.inputs import Direction, Nested, Number, Vector, takes
from jaxfem.rows.attachments import Frame, Point
from jaxfem.rows.coordinates import Coordinate, Drive, DriveValues, Limit, LimitValues


class Ends(NamedTuple):
    """Points of a and b at the anchor, and frames of a and b whose third axes are along the axis."""

    points: tuple[Point, Point]
    frames: tuple[Frame, Frame]


class AxisJoint(Joint):
    """A joint along `axis` (3,) through `anchor` (3,) [m]; a kind of it locks what is not free, and names the rest."""

    anchor: Any = field(default=None, metadata=takes(Vector("m")))
    axis: Any = field(default=None, metadata=takes(Direction()))
    low: float = field(default=-np.inf, metadata=takes(Number()))
    high: float = field(default=np.inf, metadata=takes(Number()))
    motor: Motor | None = field(default=None, metadata=takes(Nested(Motor, optional=True)))
    measure: ClassVar[str]
    """Word for the free coordinate."""
    unit: ClassVar[str]
    """Its unit."""

    def __post_init__(self) -> None:
        super().__post_init__()
        label = self.label
        checked_vector(f'anchor of "{label}"', self.anchor)
        checked_direction(f'axis of "{label}"', self.axis)
        if np.isnan([self.low, self.high]).any() or self.low > self.high:
            raise SceneError(f'limits of "{label}" are {self.low:g} to {self.high:g}: give low <= high')
        if self.motor is not None and not isinstance(self.motor, Motor):
            raise SceneError(f'motor of "{label}" is a {type(self.motor).__name__}; give a Motor(...)')

    def open_by(self) -> tuple[float, str]:
        """How far 0, where it starts, is beyond its limits."""
        return max(self.low, -self.high, 0.0), self.unit

    def parts(self, bodies: Attachments, where: str) -> Iterator[Part]:
        """Its locks, and limits and motor where it has them."""
        axes = frame_along(self.axis)
        frames = bodies.frame(self.a, axes, where), bodies.frame(self.b, axes, where)
        points = bodies.point(self.a, self.anchor, where), bodies.point(self.b, self.anchor, where)
        ends = Ends(points, frames)
        yield from self.locks(ends)
        if np.isfinite([self.low, self.high]).any():
            values = LimitValues(self.low, self.high, 0.0, 0.0)
            yield Part(f"{self.measure} limit", Limit(self.coordinate(ends)), values)
        if self.motor is not None:
            yield self._driven(self.motor, self.coordinate(ends))

    def locks(self, ends: Ends) -> Iterator[Part]:
        """Rows that hold all but the free coordinate."""
        raise NotImplementedError

    def coordinate(self, ends: Ends) -> Coordinate:
        """The free coordinate, 0 at the start."""
        raise NotImplementedError

    def _driven(self, motor: Motor, coordinate: Coordinate) -> Part:
        values = DriveValues(motor.target, motor.strength, motor.compliance, motor.damping)
        kind = "position motor" if motor.position else "motor"
        around = motor.position and not np.isfinite([self.low, self.high]).any()
        return Part(f"{self.measure} {kind}", Drive(coordinate, position=motor.position, around=around), values)
