"""A soft body as a user declares it: mesh, material, supports, loads. Host data only; checked here, once."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxfem.declared.errors import SceneError, checked_choice, refuse_traced
from jaxfem.declared.loads import Load
from jaxfem.elements.strains import PLAIN, STRAINS
from jaxfem.elements.tetra import RotationKind
from jaxfem.materials.base import Material
from jaxfem.materials.constants import DENSITY, MASS_DAMPING, MaterialError
from jaxfem.materials.linear import Linear
from jaxfem.mesh import TetMesh
from jaxfem.motion import Motion

ROTATIONS = ("polar", "gram_schmidt")


@dataclasses.dataclass(frozen=True)
class Driven:
    """Nodes (a group's name, a mask or indices) that follow a prescribed `motion`."""

    nodes: Any
    motion: Motion

    def __post_init__(self) -> None:
        refuse_traced(self)


@dataclasses.dataclass(frozen=True)
class SoftBody:
    """A soft body: a tetrahedral mesh and its material.

    `young` [Pa], `poisson` and `damping` (beta of C = beta K) [s] make it linear elastic, or `material` says what it is
    made of, like `material=Linear(young=2e5, poisson=0.3)`; `density` [kg/m^3]. Each one number, or one an element.
    `mass_damping`: alpha [1/s] of a damping C = alpha M beside it, one number a body; None: none.
    `surface`: (points (q, 3) [m], triangles (t, 3)) of a finer surface embedded in the mesh, where it is at rest:
    frames show it, and contacts touch with it that say so.
    `fixed`: nodes held in place, as a name of the mesh's groups, a mask (n,) or indices. `driven`: prescribed motions.
    `velocity`: initial, (3,) or (n, 3) [m/s]. `strain`: kind of strain rows; `rotation`: "polar" or "gram_schmidt".
    Raises SceneError or MaterialError where a value is impossible.
    """

    mesh: TetMesh
    young: Any = None
    poisson: Any = None
    density: Any = None
    damping: Any = None
    fixed: Any = None
    driven: Sequence[Driven] = ()
    loads: Sequence[Load] = ()
    velocity: Any = (0.0, 0.0, 0.0)
    strain: str = PLAIN
    rotation: RotationKind = "polar"
    name: str | None = None
    material: Material | None = None
    mass_damping: Any = None
    surface: Any = None

    def __post_init__(self) -> None:
        refuse_traced(self)
        if not isinstance(self.mesh, TetMesh):
            raise SceneError(
                f"mesh is a {type(self.mesh).__name__}, not a TetMesh: use jaxfem.mesh.read(path), mesh.box(...) "
                "or jaxfem.TetMesh(points, cells)"
            )
        label = self.label
        self._check_material()
        checked_choice(f'strain of "{label}"', self.strain, tuple(STRAINS))
        checked_choice(f'rotation of "{label}"', self.rotation, ROTATIONS)
        self.nodes_of("fixed", self.fixed)
        self._check_velocity()
        self._check_surface()
        _check_kind(label, "driven", self.driven, Driven, "driven=[Driven(nodes, Motion(...))]")
        _check_kind(label, "loads", self.loads, Load, 'loads=[Traction("x+", (0, 0, -100.0))]')
        for each in self.driven:
            self.nodes_of("driven", each.nodes)
            _check_motion(label, each.motion)

    @property
    def label(self) -> str:
        """The body's name in messages and files: its own, or its mesh's."""
        return self.name or self.mesh.name

    @property
    def made_of(self) -> Material:
        """The material with its values: `material`, or the linear one of `young`, `poisson` and `damping`."""
        return self.material or Linear(self.young, self.poisson, self.damping)

    def _check_material(self) -> None:
        label = self.label
        if self.material is not None and not isinstance(self.material, Material):
            raise MaterialError(
                f'material of "{label}" is {self.material!r}; give a law with its values, like Linear(young=2e5, '
                "poisson=0.3)"
            )
        if self.material is not None:
            refuse_traced(dict(self.material.values), type(self.material).__name__)
        short = [each.name for each in Linear.constants if getattr(self, each.name) is not None]
        if self.material is not None and short:
            raise MaterialError(
                f'"{label}" has a material and {", ".join(short)} beside it, which are short for a Linear one: give '
                f"one of both, like material={type(self.material).__name__}(...) alone"
            )
        if self.density is None:
            raise MaterialError(f'density of "{label}" is missing: give it in {DENSITY.unit}')
        try:
            values = self.made_of.values
        except MaterialError as problem:
            raise MaterialError(f'"{label}": {problem}') from None
        for each in (*self.made_of.constants, DENSITY):
            each.checked(label, values[each.name] if each is not DENSITY else self.density, len(self.mesh.cells))
        if self.mass_damping is not None:
            if np.ndim(self.mass_damping):
                shape = np.shape(self.mass_damping)
                raise MaterialError(f'mass_damping of "{label}" has shape {shape}: give one number')
            MASS_DAMPING.checked(label, self.mass_damping, len(self.mesh.cells))

    def _check_surface(self) -> None:
        if self.surface is None:
            return
        try:
            points, triangles = (np.asarray(each) for each in self.surface)
        except (TypeError, ValueError):
            points, triangles = np.zeros(0), np.zeros(0)
        good = points.ndim == triangles.ndim == 2 and points.shape[1] == triangles.shape[1] == 3 and len(triangles) > 0
        if not good or not np.isfinite(points).all() or not np.issubdtype(triangles.dtype, np.integer):
            raise SceneError(
                f'surface of "{self.label}" must be a pair: points (q, 3) in m, and triangles (t, 3) of their numbers'
            )
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise SceneError(f'surface of "{self.label}" has triangles of points that are not among its {len(points)}')

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
