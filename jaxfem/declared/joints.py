"""Joints as a user declares them. Places and axes are those of the start, in the world frame.

`a` and `b` are bodies of the scene (the objects themselves, or their names), or None for the world. In soft bodies a
joint holds a material point; joints with an axis need rigid bodies or the world on both sides.
"""

import dataclasses
from typing import Any

import numpy as np

from jaxfem.declared.errors import SceneError, checked_direction, checked_number, checked_vector


@dataclasses.dataclass(frozen=True)
class Motor:
    """Drives a hinge's angle or a slider's travel.

    `target`: a rate [rad/s or m/s] or, with `position`, a value [rad or m]. `strength`: torque or force at most [N m or
    N]. `compliance` and `damping` as of joints: a position motor is a bounded spring 1 / compliance with a damper.
    """

    target: float
    strength: float
    position: bool = False
    compliance: float = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        checked_number("target of a motor", self.target)
        checked_number("strength of a motor", self.strength, low=0)
        checked_number("compliance of a motor", self.compliance, low=0)
        checked_number("damping of a motor", self.damping, low=0)


@dataclasses.dataclass(frozen=True, eq=False)
class Joint:
    """What all joints share: bodies, `compliance` [m/N, rad/(N m)] and `damping` [N s/m, N m s] (0: rigid), a name."""

    a: Any
    b: Any
    compliance: float = dataclasses.field(default=0.0, kw_only=True)
    damping: float = dataclasses.field(default=0.0, kw_only=True)
    name: str | None = dataclasses.field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.a is None and self.b is None:
            raise SceneError(f'"{self.label}" joins the world to itself: give a body')
        checked_number(f'compliance of "{self.label}"', self.compliance, low=0)
        checked_number(f'damping of "{self.label}"', self.damping, low=0)

    @property
    def label(self) -> str:
        """The joint's name in messages."""
        return self.name or type(self).__name__


@dataclasses.dataclass(frozen=True, eq=False)
class BallJoint(Joint):
    """A point of `a` and a point of `b` coincide: `anchor` (3,) [m], or `anchor` of a and `anchor_b` of b."""

    anchor: Any = None
    anchor_b: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector(f'anchor of "{self.label}"', self.anchor)
        if self.anchor_b is not None:
            checked_vector(f'anchor_b of "{self.label}"', self.anchor_b)


@dataclasses.dataclass(frozen=True, eq=False)
class WeldJoint(Joint):
    """`a` and `b` move as one.

    Between rigid bodies or the world: all of their relative motion is locked at `anchor`. With a soft `a`: each of its
    `nodes` (a group's name, a mask or indices) is tied to the material point of `b` at its place.
    """

    anchor: Any = (0.0, 0.0, 0.0)
    nodes: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector(f'anchor of "{self.label}"', self.anchor)


@dataclasses.dataclass(frozen=True, eq=False)
class DistanceJoint(Joint):
    """The distance between `anchor` of a and `anchor_b` of b is `length` [m] (that of the start without it).

    `rope`: at most that length. In a rope only tension acts.
    """

    anchor: Any = None
    anchor_b: Any = None
    length: float | None = None
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
    def rest_length(self) -> float:
        """The length to hold [m]."""
        start = np.linalg.norm(np.asarray(self.anchor_b, float) - np.asarray(self.anchor, float))
        return float(start if self.length is None else self.length)


@dataclasses.dataclass(frozen=True, eq=False)
class _AxisJoint(Joint):
    anchor: Any = None
    axis: Any = None
    low: float = -np.inf
    high: float = np.inf
    motor: Motor | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        label = self.label
        checked_vector(f'anchor of "{label}"', self.anchor)
        checked_direction(f'axis of "{label}"', self.axis)
        if np.isnan([self.low, self.high]).any() or self.low > self.high:
            raise SceneError(f'limits of "{label}" are {self.low:g} to {self.high:g}: give low <= high')
        if self.motor is not None and not isinstance(self.motor, Motor):
            raise SceneError(f'motor of "{label}" is a {type(self.motor).__name__}; give a Motor(...)')


class HingeJoint(_AxisJoint):
    """Bodies turn about a common `axis` (3,) through `anchor`. The angle of b from a is 0 at the start [rad].

    `low`, `high`: its limits, within -pi to pi; `motor`: a Motor on the angle.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        for bound in (self.low, self.high):
            if np.isfinite(bound) and abs(bound) > np.pi:
                raise SceneError(f'a limit of "{self.label}" is {bound:g} rad: angles run from -pi to pi')


class SliderJoint(_AxisJoint):
    """b moves against a along an `axis` (3,) only, and does not turn. The travel is 0 at the start [m].

    `low`, `high`: its limits; `motor`: a Motor on the travel.
    """
