"""What a user declares: the scene that holds all bodies. Host data only; checked here, once."""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxfem.declared import Joint, RigidBody, SceneError
from jaxfem.declared.errors import refuse_traced
from jaxfem.declared.soft import ROTATIONS, Driven, SoftBody
from jaxfem.elements.strains import STRAINS

__all__ = ["ROTATIONS", "STRAINS", "Driven", "Scene", "SceneError", "SoftBody"]


@dataclasses.dataclass(frozen=True)
class Scene:
    """Soft and rigid bodies, the `joints` and `contacts` between them, and `gravity` (3,) [m/s^2].

    Bodies' names must differ; unnamed equal ones are numbered by `build`. Bodies touch only where a contact says so.
    """

    bodies: Sequence[SoftBody | RigidBody]
    gravity: Any = (0.0, 0.0, -9.81)
    joints: Sequence[Joint] = ()
    contacts: Sequence[Any] = ()

    def __post_init__(self) -> None:
        refuse_traced(self)
        if isinstance(self.bodies, SoftBody | RigidBody):
            raise SceneError(f"bodies is a single {type(self.bodies).__name__}: write Scene([body])")
        if len(self.bodies) == 0:
            raise SceneError("the scene holds no body: write Scene([body])")
        for body in self.bodies:
            if not isinstance(body, SoftBody | RigidBody):
                raise SceneError(f"a scene holds SoftBody and RigidBody objects, not {type(body).__name__}")
        if not isinstance(self.joints, Sequence) or not all(isinstance(each, Joint) for each in self.joints):
            raise SceneError("joints is no list of joints: write joints=[BallJoint(a, b, anchor), ...]")
        gravity = np.asarray(self.gravity, dtype=np.float64)
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise SceneError(f"gravity is {self.gravity!r}; give three finite numbers in m/s^2, like (0, 0, -9.81)")
        if not isinstance(self.contacts, Sequence):
            raise SceneError("contacts is no list: write contacts=[Contact(a, b), ...]")
        names = Counter(body.name for body in self.bodies if body.name)
        for name, count in names.items():
            if count > 1:
                raise SceneError(f'two bodies are called "{name}": give each its own name')

    @property
    def soft(self) -> list[SoftBody]:
        """The soft bodies, in order."""
        return [body for body in self.bodies if isinstance(body, SoftBody)]

    @property
    def rigid(self) -> list[RigidBody]:
        """The rigid bodies, in order."""
        return [body for body in self.bodies if isinstance(body, RigidBody)]
