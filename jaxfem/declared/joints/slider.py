"""A joint that leaves a travel."""

from collections.abc import Iterator
from typing import ClassVar

from jaxfem.declared.joints.axis import AxisJoint, Ends
from jaxfem.declared.joints.base import Part
from jaxfem.rows.coordinates import Coordinate, Travel
from jaxfem.rows.locks import FrameLock, LineLock


class SliderJoint(AxisJoint, kind="slider"):
    """b moves against a along an `axis` (3,) only, and does not turn. The travel is 0 at the start [m].

    `low`, `high`: its limits; `motor`: a Motor on the travel.
    """

    measure: ClassVar[str] = "travel"
    unit: ClassVar[str] = "m"

    def locks(self, ends: Ends) -> Iterator[Part]:
        """The line along the axis, and all turns."""
        yield Part("line", LineLock(*ends.points, ends.frames[0]), self.softness)
        yield Part("frame", FrameLock(*ends.frames), self.softness)

    def coordinate(self, ends: Ends) -> Coordinate:
        """How far along the axis."""
        return Travel(*ends.points, ends.frames[0])
