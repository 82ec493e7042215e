"""What drives a joint."""

import dataclasses

from jaxfem.declared.errors import checked_number, refuse_traced
from jaxfem.inputs import Flag, Number, takes


@dataclasses.dataclass(frozen=True)
class Motor:
    """Drives a hinge's angle or a slider's travel.

    `target`: a rate [rad/s or m/s] or, with `position`, a value [rad or m]. `strength`: torque or force at most [N m or
    N]. `compliance` and `damping` as of joints: a position motor is a bounded spring 1 / compliance with a damper; that
    of a hinge without limits goes the short way round.
    """

    target: float = dataclasses.field(metadata=takes(Number()))
    strength: float = dataclasses.field(metadata=takes(Number()))
    position: bool = dataclasses.field(default=False, metadata=takes(Flag()))
    compliance: float = dataclasses.field(default=0.0, metadata=takes(Number()))
    damping: float = dataclasses.field(default=0.0, metadata=takes(Number()))

    def __post_init__(self) -> None:
        refuse_traced(self)
        checked_number("target of a motor", self.target)
        checked_number("strength of a motor", self.strength, low=0)
        checked_number("compliance of a motor", self.compliance, low=0)
        checked_number("damping of a motor", self.damping, low=0)
