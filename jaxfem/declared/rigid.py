"""A rigid body as a user declares it."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from jaxfem.answers import numbers
from jaxfem.declared.errors import SceneError, checked_number, checked_vector, refuse_traced
from jaxfem.inputs import Flag, Number, Text, Vector, takes
from jaxfem.motion import Motion
from jaxfem.rigid.shapes.answers import mass_flaw, touching_flaw
from jaxfem.rigid.shapes.base import Shape, solids


@dataclass(frozen=True, eq=False)
class RigidBody:
    """A rigid body: a shape (`Sphere`, `Box`, `Capsule`, `Cylinder`, `TriangleMesh`, or one of your own), mass, start.

    `density` [kg/m^3] or `mass` [kg], one of them; `inertia` (3, 3) [kg m^2] about the centre of mass in the shape's
    frame, the shape's own without it. `position` (3,) [m] of the shape's origin and `orientation`, a quaternion, scalar
    first; `velocity` of the centre of mass [m/s] and `angular_velocity` [rad/s], in the world frame. `fixed`: it never
    moves; `motion`: it follows a prescribed motion. Raises SceneError.
    """

    shape: Any
    density: Any = field(default=None, metadata=takes(Number("kg/m^3", positive=True, optional=True)))
    mass: Any = field(default=None, metadata=takes(Number("kg", positive=True, optional=True)))
    position: Any = field(default=(0.0, 0.0, 0.0), metadata=takes(Vector("m")))
    orientation: Any = field(default=(1.0, 0.0, 0.0, 0.0), metadata=takes(Vector(length=4)))
    velocity: Any = field(default=(0.0, 0.0, 0.0), metadata=takes(Vector("m/s")))
    angular_velocity: Any = field(default=(0.0, 0.0, 0.0), metadata=takes(Vector("rad/s")))
    fixed: bool = field(default=False, metadata=takes(Flag()))
    motion: Motion | None = None
    inertia: Any = None
    name: str | None = field(default=None, metadata=takes(Text(optional=True)))

    def __post_init__(self) -> None:
        refuse_traced(self)
        label = self.label
        if not (isinstance(self.shape, Shape) and self.shape.is_solid()):
            known = ", ".join(each.__name__ for each in solids())
            raise SceneError(f'shape of "{label}" is a {type(self.shape).__name__}; a rigid body is one of {known}')
        if flaw := self.shape.flaw(label):
            raise SceneError(flaw)
        if flaw := touching_flaw(self.shape):
            raise SceneError(f'the shape of "{label}", {type(self.shape).__name__}: {flaw}')
        if (self.density is None) == (self.mass is None):
            raise SceneError(f'"{label}" needs `density` in kg/m^3 or `mass` in kg, one of them')
        for what in ("density", "mass"):
            if getattr(self, what) is not None:
                checked_number(f'{what} of "{label}"', getattr(self, what), low=0, open_low=True)
        for what in ("position", "velocity", "angular_velocity"):
            checked_vector(f'{what} of "{label}"', getattr(self, what))
        if np.linalg.norm(checked_vector(f'orientation of "{label}"', self.orientation, 4)) == 0:
            raise SceneError(f'orientation of "{label}" is all zeros; a quaternion is (1, 0, 0, 0) where nothing turns')
        if self.motion is not None and (self.fixed or not isinstance(self.motion, Motion)):
            raise SceneError(f'motion of "{label}": give a Motion(...), and not `fixed` as well')
        self._check_inertia()

    @property
    def label(self) -> str:
        """The body's name in messages and files: its own, or its shape's."""
        return self.name or type(self.shape).__name__.lower()

    @cached_property
    def properties(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass [kg], centre of mass (3,) [m] in the shape's frame, inertia per mass about it (3, 3) [m^2]."""
        found: Any = self.shape.mass_properties()
        if flaw := mass_flaw(found):
            raise SceneError(f'the shape of "{self.label}", {type(self.shape).__name__}: {flaw}')
        volume, center, inertia = found
        weighed = self.mass is not None or (np.isfinite(volume) and volume > 0)
        turned = self.inertia is not None or _definite(inertia)
        if not (weighed and turned and np.isfinite(center).all()):
            raise SceneError(
                f'the shape of "{self.label}", {type(self.shape).__name__}, has mass_properties that no solid has: '
                "give a volume above 0 [m^3], a centre (3,) [m], and an inertia per mass (3, 3) [m^2], symmetric and "
                "positive definite"
            )
        mass = float(self.mass if self.mass is not None else self.density * volume)
        return mass, center, inertia if self.inertia is None else np.asarray(self.inertia, float) / mass

    def _check_inertia(self) -> None:
        if self.inertia is None:
            return
        if not _definite(self.inertia):
            raise SceneError(f'inertia of "{self.label}" must be a symmetric positive definite (3, 3) matrix in kg m^2')


def _definite(given: Any) -> bool:
    """Whether it is a symmetric positive definite (3, 3) matrix."""
    inertia = numbers(given)
    if inertia is None:
        return False
    good = inertia.shape == (3, 3) and np.isfinite(inertia).all() and np.allclose(inertia, inertia.T)
    return bool(good and np.linalg.eigvalsh(inertia).min() > 0)
