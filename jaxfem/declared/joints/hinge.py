"""A joint that leaves a turn."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from jaxfem.declared.errors import SceneError
from jaxfem.declared.joints.axis import AxisJoint, Ends
from jaxfem.declared.joints.base import Part
from jaxfem.rows.coordinates import Angle, Coordinate
from jaxfem.rows.locks import FrameLock, PointLock


class HingeJoint(AxisJoint, kind="hinge"):
    """Bodies turn about a common `axis` (3,) through `anchor`. The angle of b from a is 0 at the start [rad].

    `low`, `high`: its limits, within -pi to pi; `motor`: a Motor on the angle.
    """

    measure: ClassVar[str] = "angle"
    unit: ClassVar[str] = "rad"

    def __post_init__(self) -> None:
        super().__post_init__()
        for bound in (self.low, self.high):
            if np.isfinite(bound) and abs(bound) > np.pi:
                raise SceneError(f'a limit of "{self.label}" is {bound:g} rad: angles run from -pi to pi')

    def locks(self, ends: Ends) -> Iterator[Part]:
        """A point, and the direction of the axis."""
        yield Part("point", PointLock(*ends.points), self.softness)
        yield Part("axis", FrameLock(*ends.frames, held=2), self.softness)

    def coordinate(self, ends: Ends) -> Coordinate:
        """The angle about the axis."""
        return Angle(*ends.frames)
