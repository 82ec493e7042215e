"""Which body is which number, where its points are, and the rigid bodies' arrays."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.declared import RigidBody, SceneError
from jaxfem.mesh import locate
from jaxfem.pytrees import on_device
from jaxfem.rigid.dynamics import RigidParams, RigidSet, RigidState
from jaxfem.rigid.slender import slender
from jaxfem.rows.attachments import Frame, Point, RigidFrame, RigidPoint, SoftPoint, WorldFrame, WorldPoint

OUTSIDE = 1e-6  # of a soft body's size: how far an anchor may lie off its mesh
SAME = 1e-12  # of a moment of inertia: what shapes' own sums round to


class BodyIndex:
    """Bodies of a scene by object or name, and attachments to them; all values are NumPy, for one joint at a time."""

    def __init__(
        self,
        soft: Sequence[Any],
        soft_names: Sequence[str],
        rigid: Sequence[RigidBody],
        names: Sequence[str],
        gravity: Any = (0.0, 0.0, 0.0),
    ):
        self.soft, self.rigid, self.gravity = list(soft), list(rigid), gravity
        self.offsets = np.cumsum([0] + [len(each.mesh.points) for each in soft])
        self._names = {"soft": list(soft_names), "rigid": list(names)}
        self._by_object = {id(body): ("soft", i) for i, body in enumerate(soft)}
        self._by_object |= {id(body): ("rigid", i) for i, body in enumerate(rigid)}
        self._by_name = {name: ("soft", i) for i, name in enumerate(soft_names)}
        self._by_name |= {name: ("rigid", i) for i, name in enumerate(names)}
        turns = np.array([np.asarray(body.orientation, float) for body in rigid]).reshape(-1, 4)
        self.rotations = _matrices(turns)
        self.centers = np.array(
            [np.asarray(b.position, float) + R @ b.properties[1] for b, R in zip(rigid, self.rotations, strict=True)]
        ).reshape(-1, 3)

    def find(self, body: Any, where: str) -> tuple[str, int]:
        """("soft" or "rigid", number), or ("world", 0) for None; SceneError says which joint names an unknown body."""
        if body is None:
            return "world", 0
        found = self._by_name.get(body) if isinstance(body, str) else self._by_object.get(id(body))
        if found is None:
            names = ", ".join(f'"{name}"' for name in list(self._by_name)[:8])
            shown = f'"{body}"' if isinstance(body, str) else f"a {type(body).__name__}"
            raise SceneError(f"{where} names {shown}, which is not a body of the scene: it holds {names}")
        return found

    def name(self, kind: str, number: int) -> str:
        """The name of a "soft" or "rigid" body."""
        return self._names[kind][number]

    def point(self, body: Any, place: Any, where: str) -> Point:
        """The material point of a body at a world place (3,) at the start."""
        kind, number = self.find(body, where)
        place = np.asarray(place, float)
        if kind == "world":
            return WorldPoint(place)
        if kind == "rigid":
            return RigidPoint(np.array(number, np.int32), self.rotations[number].T @ (place - self.centers[number]))
        mesh = self.soft[number].mesh
        cell, weights, distance = locate(mesh.points, mesh.cells, place[None])
        if distance[0] > OUTSIDE * np.ptp(mesh.points, axis=0).max():
            raise SceneError(
                f'{where} holds "{self.soft[number].label}" at {tuple(place.tolist())}, {distance[0]:.3g} m outside '
                "it: give a point of the body"
            )
        return SoftPoint((mesh.cells[cell[0]] + self.offsets[number]).astype(np.int32), weights[0])

    def frame(self, body: Any, axes: np.ndarray, where: str) -> Frame:
        """A frame with world `axes` (3, 3), in columns, at the start."""
        kind, number = self.find(body, where)
        if kind == "soft":
            raise SceneError(
                f'{where} needs an orientation, which a point of the soft body "{self.soft[number].label}" has not: '
                "weld a rigid body to some of its nodes and join that"
            )
        if kind == "world":
            return WorldFrame(axes)
        return RigidFrame(np.array(number, np.int32), self.rotations[number].T @ axes)


def _matrices(turns: np.ndarray) -> np.ndarray:
    """Rotation matrices (b, 3, 3) of quaternions (b, 4), scalar first, of any length."""
    if not len(turns):
        return np.zeros((0, 3, 3))
    from scipy.spatial.transform import Rotation  # slow to import: scenes of soft bodies alone do without

    matrices: np.ndarray = Rotation.from_quat(turns[:, [1, 2, 3, 0]]).as_matrix()
    return matrices


def _isotropic(inertias: np.ndarray) -> bool:
    """Whether each of inertias (k, 3, 3) is the same about any axis."""
    mean = np.trace(inertias, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return bool(np.all(np.abs(inertias - mean) <= SAME * np.abs(mean).max(axis=(1, 2), keepdims=True)))


def rigid_parts(
    bodies: Sequence[RigidBody], names: Sequence[str], index: BodyIndex, dtype: Any
) -> tuple[RigidSet, RigidParams, RigidState]:
    """(RigidSet, RigidParams, RigidState) of the declared bodies, in their order."""

    def real(values: Any) -> jax.Array:
        return on_device(values, dtype)

    masses, _, inertias = zip(*[body.properties for body in bodies], strict=True)
    orientations = np.array([np.asarray(body.orientation, float) for body in bodies])
    orientations /= np.linalg.norm(orientations, axis=1, keepdims=True)
    driven = [i for i, body in enumerate(bodies) if body.motion is not None]
    still = [body.fixed or body.motion is not None for body in bodies]
    made = RigidSet(
        inertia_per_mass=real(np.stack(inertias)),
        free=real(~np.array(still)),
        start=real(index.centers),
        start_orientation=real(orientations),
        driven=on_device(driven, jnp.int32),
        names=tuple(names),
        slender=slender(np.stack(inertias), ~np.array(still), dtype),
        isotropic=_isotropic(np.stack(inertias)[[not body.fixed for body in bodies]]),
    )
    motions = tuple(
        jax.tree.map(real, bodies[i].motion, is_leaf=lambda v: isinstance(v, tuple | list | np.ndarray)) for i in driven
    )
    moving = np.where(np.array([body.fixed for body in bodies])[:, None], 0.0, 1.0)
    state = RigidState(
        made.start,
        made.start_orientation,
        real(moving * np.array([np.asarray(body.velocity, float) for body in bodies])),
        real(moving * np.array([np.asarray(body.angular_velocity, float) for body in bodies])),
    )
    return made, RigidParams(real(masses), motions), state
