"""What a joint is: bodies, places and axes at the start in the world frame, and the rows that it is made of.

`a` and `b` are bodies of the scene (the objects themselves, or their names), or None for the world. In soft bodies a
joint holds a material point; joints with an axis need rigid bodies or the world on both sides.

A kind of joint is a subclass, wherever it is defined: its fields, and `parts`, which yields its rows. It becomes a
frozen dataclass and registers itself under the word that scene files call it.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxfem.answers import odd_fields
from jaxfem.declared.errors import SceneError, checked_number, refuse_traced
from jaxfem.inputs import Declared, Number, Text, inputs_of, takes
from jaxfem.registry import Registry
from jaxfem.rows.attachments import Frame, Point
from jaxfem.rows.locks import JointRows, Softness


class Attachments(Protocol):
    """The bodies of a scene, for joints to hold on to. `where` names the joint in errors."""

    soft: list[Any]

    def find(self, body: Any, where: str) -> tuple[str, int]:
        """("soft", "rigid" or "world", number among those)."""

    def point(self, body: Any, place: Any, where: str) -> Point:
        """The material point of a body at a world place (3,) at the start."""

    def frame(self, body: Any, axes: np.ndarray, where: str) -> Frame:
        """A frame fixed in a rigid body or the world, with world `axes` (3, 3), in columns, at the start."""


class Part(NamedTuple):
    """Rows of one joint: a word for them in their group's name, the rows and what users differentiate of them.

    All values are those of a single row block, without the leading axis: those of all joints are stacked.
    """

    word: str
    rows: JointRows
    values: Any


class Joint(Declared):
    """What all joints share: bodies, `compliance` [m/N, rad/(N m)] and `damping` [N s/m, N m s] (0: rigid), a name.

    A subclass gives the word of its `kind` in scene files, and further words with the fields that they fix in
    `variants`; one without a kind is a base of others, or for Python alone.
    """

    a: Any = dataclasses.field(metadata=takes(Text(optional=True)))
    b: Any = dataclasses.field(metadata=takes(Text(optional=True)))
    compliance: float = dataclasses.field(default=0.0, kw_only=True, metadata=takes(Number()))
    damping: float = dataclasses.field(default=0.0, kw_only=True, metadata=takes(Number()))
    name: str | None = dataclasses.field(default=None, kw_only=True, metadata=takes(Text(optional=True)))

    def __init_subclass__(
        cls, kind: str | None = None, variants: Mapping[str, Mapping[str, Any]] | None = None, **kwargs: Any
    ) -> None:
        super().__init_subclass__(**kwargs)
        if kind is None:
            return
        if cls.parts is Joint.parts:
            raise TypeError(f"{cls.__name__} does not say which rows it is made of: define `parts`")
        known = [each.name for each in dataclasses.fields(cls)]
        if (odd := odd_fields(variants or {}, known)) is not None:
            raise TypeError(
                f"{cls.__name__} has variants{odd[0]} = {odd[1]!r}: give a mapping of words to fields and their "
                f"values; its fields are {', '.join(known)}"
            )
        JOINTS.add(kind, cls)
        for word, fixed in (variants or {}).items():
            JOINTS.add(word, cls, **fixed)

    def __post_init__(self) -> None:
        refuse_traced(self)
        if self.a is None and self.b is None:
            raise SceneError(f'"{self.label}" joins the world to itself: give a body')
        checked_number(f'compliance of "{self.label}"', self.compliance, low=0)
        checked_number(f'damping of "{self.label}"', self.damping, low=0)

    def unused(self) -> Iterator[str]:
        """What it has that changes nothing, in words; numbers of its rows tell that themselves."""
        yield from ()

    def open_by(self) -> tuple[float, str]:
        """How far it is from where it holds at the start, if it is rigid, and the unit of that; 0 where it holds."""
        return 0.0, "m"

    def flaw(self) -> str:
        """What is wrong with a field, and what to do; empty where nothing is. Values that it may leave out may be."""
        defaults = {each.name: each.default for each in dataclasses.fields(self)}
        for name, each in inputs_of(self).items():
            value = getattr(self, name)
            if value is None and not each.optional:
                return f'"{self.label}" needs `{name}`: {each.flaw(value)}'
            given = not (value is defaults[name] or (np.isscalar(value) and value == defaults[name]))
            if value is not None and given and (flaw := each.flaw(value)):
                return f'{name} of "{self.label}" is {value!r}; {flaw}'
        return ""

    @property
    def label(self) -> str:
        """The joint's name in messages."""
        return self.name or type(self).__name__

    @property
    def softness(self) -> Softness:
        """Its compliance and damping, as values of locks."""
        return Softness(float(self.compliance), float(self.damping))

    def parts(self, bodies: Attachments, where: str) -> Iterator[Part]:
        """The rows that it is made of; `where` names it in errors."""
        raise NotImplementedError(f"{type(self).__name__} does not say which rows it is made of")


JOINTS: Registry[Joint] = Registry("joint kind")
"""All joints by their words."""


def frame_along(axis: Any) -> np.ndarray:
    """A right-handed orthonormal frame (3, 3), columns, whose third axis is along `axis` (3,)."""
    third = np.asarray(axis, float) / np.linalg.norm(axis)
    spare = np.eye(3)[np.argmin(np.abs(third))]
    first = np.cross(spare, third)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third], -1)
