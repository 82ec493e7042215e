"""What a user declares: soft bodies and the scene that holds them. Host data only; checked here, once."""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxfem.declared import Joint, RigidBody, SceneError
from jaxfem.declared.loads import Load
from jaxfem.elements.smoothing import STRAINS
from jaxfem.materials.moduli import check_material
from jaxfem.mesh import TetMesh
from jaxfem.motion import Motion

ROTATIONS = ("polar", "gram_schmidt")


@dataclasses.dataclass(frozen=True)
class Driven:
    """Nodes (a group's name, a mask or indices) that follow a prescribed `motion`."""

    nodes: Any
    motion: Motion


@dataclasses.dataclass(frozen=True)
class SoftBody:
    """A soft body: a tetrahedral mesh and its material.

    `young` [Pa], `poisson`, `density` [kg/m^3] and `damping` (beta of C = beta K) [s]: one number, or one an element.
    `fixed`: nodes held in place, as a name of the mesh's groups, a mask (n,) or indices. `driven`: prescribed motions.
    `velocity`: initial, (3,) or (n, 3) [m/s]. `strain`: kind of strain rows; `rotation`: "polar" or "gram_schmidt".
    Raises SceneError or MaterialError where a value is impossible.
    """

    mesh: TetMesh
    young: Any
    poisson: Any
    density: Any
    damping: Any = 0.0
    fixed: Any = None
    driven: Sequence[Driven] = ()
    loads: Sequence[Load] = ()
    velocity: Any = (0.0, 0.0, 0.0)
    strain: str = "element"
    rotation: str = "polar"
    name: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.mesh, TetMesh):
            raise SceneError(
                f"mesh is a {type(self.mesh).__name__}, not a TetMesh: use jaxfem.mesh.read(path), mesh.box(...) "
                "or jaxfem.TetMesh(points, cells)"
            )
        label = self.label
        for name in ("young", "poisson", "density", "damping"):
            check_material(label, name, getattr(self, name), len(self.mesh.cells))
        _check_choice(label, "strain", self.strain, tuple(STRAINS))
        _check_choice(label, "rotation", self.rotation, ROTATIONS)
        self.nodes_of("fixed", self.fixed)
        self._check_velocity()
        _check_kind(label, "driven", self.driven, Driven, "driven=[Driven(nodes, Motion(...))]")
        _check_kind(label, "loads", self.loads, Load, 'loads=[Traction("x+", (0, 0, -100.0))]')
        for each in self.driven:
            self.nodes_of("driven", each.nodes)
            _check_motion(label, each.motion)

    @property
    def label(self) -> str:
        """The body's name in messages and files: its own, or its mesh's."""
        return self.name or self.mesh.name

    def nodes_of(self, what: str, selection: Any) -> np.ndarray:
        """Node indices of a selection: None, a group's name, a mask (n,) or indices."""
        count = len(self.mesh.points)
        if selection is None:
            return np.zeros(0, np.int64)
        if isinstance(selection, str):
            return np.asarray(self.mesh.nodes(selection))
        array = np.atleast_1d(np.asarray(selection))
        if array.dtype == bool:
            if array.shape != (count,):
                raise SceneError(
                    f'{what} of "{self.label}" is a mask of shape {array.shape}; it needs one entry for each of the '
                    f"{count} nodes"
                )
            return np.flatnonzero(array)
        return self._checked_indices(what, array, count)

    def _checked_indices(self, what: str, array: np.ndarray, count: int) -> np.ndarray:
        if array.size and not np.issubdtype(array.dtype, np.integer):
            raise SceneError(
                f'{what} of "{self.label}" has dtype {array.dtype}: give a mask of booleans, node indices or a name'
            )
        bad = array[(array < 0) | (array >= count)]
        if bad.size:
            raise SceneError(f'{what} of "{self.label}" names node {bad[0]}; its nodes run from 0 to {count - 1}')
        return np.unique(array).astype(np.int64)

    def _check_velocity(self) -> None:
        velocity = np.asarray(self.velocity, dtype=np.float64)
        count = len(self.mesh.points)
        if velocity.shape not in ((3,), (count, 3)) or not np.isfinite(velocity).all():
            raise SceneError(
                f'velocity of "{self.label}" has shape {velocity.shape}; give three finite numbers, or ({count}, 3)'
            )


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


def _check_choice(label: str, what: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise SceneError(f'{what} of "{label}" is {value!r}; known: {", ".join(known)}')


def _check_kind(label: str, what: str, given: Any, kind: Any, example: str) -> None:
    if not isinstance(given, Sequence) or not all(isinstance(each, kind) for each in given):
        raise SceneError(f'{what} of "{label}" is {given!r}; give a list, like {example}')


def _check_motion(label: str, motion: Any) -> None:
    if not isinstance(motion, Motion):
        raise SceneError(f'a driven set of "{label}" has a {type(motion).__name__} for a motion; give a Motion(...)')
    for field in dataclasses.fields(motion):
        value = np.asarray(getattr(motion, field.name), dtype=np.float64)
        shape = np.shape(field.default)  # type: ignore[arg-type]
        if value.shape != shape or not np.isfinite(value).all():
            needed = "three finite numbers" if shape else "one finite number"
            raise SceneError(f'{field.name} of a motion of "{label}" is {value.tolist()}; give {needed}')
