"""The [[rigid]], [[joint]] and [[contact]] tables of a scene file. What each kind takes, its class declares."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.declared import Contact, Joint, RigidBody
from jaxfem.declared.joints import JOINTS
from jaxfem.declared.scene import SoftBody
from jaxfem.inputs import TableLike, inputs_of, read_fields
from jaxfem.io.scene_bodies import MOTION_KEYS, read_motion
from jaxfem.io.selections import select_nodes
from jaxfem.io.toml_tables import SceneFileError, Table
from jaxfem.mesh import read_surface
from jaxfem.rigid.shapes.base import Shape, obstacles, solids

RIGID_KEYS = ("shape", "rotate", "motion", *inputs_of(RigidBody))
CONTACT_KEYS = ("ground", *inputs_of(Contact))


@dataclasses.dataclass(frozen=True)
class SceneSources:
    """What tables of a scene refer to: files in its `folder`, and its `soft` bodies."""

    folder: Path
    soft: Sequence[SoftBody] = ()

    def nodes(self, table: Any, key: str) -> np.ndarray:
        """Node numbers (k,) of a selection, of the soft body that the table calls `a`."""
        name = table.text("a")
        for body in self.soft:
            if body.label == name:
                return select_nodes(table, key, body.mesh)
        known = ", ".join(f'"{body.label}"' for body in self.soft) or "none"
        raise SceneFileError(
            f"{key!r} in {table.where} are those of a soft body, but 'a' is \"{name}\": they are {known}"
        )

    def surface(self, table: TableLike) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) [m] and triangles (t, 3) of the surface that `file` and `scale` of a table name."""
        return read_surface(self.folder / table.text("file"), table.number("scale", None, positive=True))


def read_rigid(table: Table, sources: SceneSources) -> RigidBody:
    """The rigid body that a [[rigid]] table describes."""
    if "orientation" in table and "rotate" in table:
        raise SceneFileError(f"{table.where} has both 'orientation' and 'rotate': give one of them")
    motion = None
    if "motion" in table:
        motion = read_motion(table.table("motion", MOTION_KEYS, f"'motion' in {table.where}"))
    shape = _shape(table, "shape", solids(), sources)
    values = read_fields(RigidBody, table, sources)
    if "rotate" in table:
        values["orientation"] = _turn(table)
    return RigidBody(shape, motion=motion, **values)


def read_joint(values: dict[str, Any], where: str, sources: SceneSources) -> Joint:
    """The joint that a [[joint]] table describes."""
    word = Table(values, where, None).choice("kind", JOINTS.words())
    kind = JOINTS[word]
    table = Table(values, f"{where} ({word})", ("kind", *inputs_of(kind.made)))
    return kind.made(**read_fields(kind.made, table, sources, left=kind.fixed), **kind.fixed)


def read_contact(table: Table, sources: SceneSources) -> Contact:
    """The contact that a [[contact]] table describes."""
    if ("b" in table) == ("ground" in table):
        both = "both 'b' and 'ground'" if "b" in table else "neither 'b' (a body's name) nor 'ground'"
        raise SceneFileError(f"{table.where} has {both}: give one of them")
    if "ground" not in table:
        return Contact(**read_fields(Contact, table, sources))
    ground = _shape(table, "ground", obstacles(), sources)
    return Contact(b=ground, **read_fields(Contact, table, sources, left=("b",)))


def _shape(table: Table, key: str, kinds: Sequence[type[Shape]], sources: SceneSources) -> Shape:
    """The shape that the table at `key` names, one of those `kinds`."""
    where, raw = f"{key!r} in {table.where}", table.get(key)
    words = [str(kind.word) for kind in kinds]
    if not isinstance(raw, dict):
        raise table.wrong(key, f"a table like {' or '.join(kind.example() for kind in kinds[:3])}")
    given = [kind for kind in kinds if kind.word in raw]
    if len(given) != 1:
        Table(raw, where, {*words, *(each for kind in kinds for each in kind.keys())})
        named = " and ".join(str(kind.word) for kind in given) or "no kind"
        raise SceneFileError(f"{where} names {named}: give one of {', '.join(words)}")
    (kind,) = given
    return kind.read(Table(raw, f"{where} (a {kind.word})", kind.keys()), sources)


def _turn(table: Table) -> tuple[float, ...]:
    from scipy.spatial.transform import Rotation  # slow to import: only where a body is turned

    turn = table.table("rotate", ("axis", "degrees"), f"'rotate' in {table.where}")
    axis = np.array(turn.vector("axis"))
    if not axis.any():
        raise turn.wrong("axis", "a direction, not all zeros")
    vector = axis / np.linalg.norm(axis) * np.radians(turn.number("degrees"))
    x, y, z, w = Rotation.from_rotvec(vector).as_quat()
    return (float(w), float(x), float(y), float(z))
