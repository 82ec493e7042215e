"""The [[rigid]], [[joint]] and [[contact]] tables of a scene file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.declared import (
    BallJoint,
    Contact,
    DistanceJoint,
    HingeJoint,
    Joint,
    Motor,
    RigidBody,
    SliderJoint,
    WeldJoint,
)
from jaxfem.declared.scene import SoftBody
from jaxfem.io.scene_bodies import MOTION_KEYS, read_motion
from jaxfem.io.selections import select_nodes
from jaxfem.io.toml_tables import SceneFileError, Table, is_number
from jaxfem.mesh import read_surface
from jaxfem.rigid.shapes import Box, Capsule, Cylinder, HeightField, Plane, Sphere, TriangleMesh

RIGID_KEYS = (
    *("name", "shape", "density", "mass", "position", "orientation", "rotate", "velocity", "angular_velocity"),
    *("fixed", "motion"),
)
SHAPE_KEYS = {"sphere": (), "box": (), "capsule": ("length",), "cylinder": ("length",), "file": ("scale",)}
JOINT_SHARED = ("kind", "name", "a", "b", "compliance", "damping")
JOINT_KEYS = {
    "ball": ("anchor", "anchor_b"),
    "hinge": ("anchor", "axis", "low", "high", "motor"),
    "slider": ("anchor", "axis", "low", "high", "motor"),
    "weld": ("anchor", "nodes"),
    "distance": ("anchor", "anchor_b", "length"),
    "rope": ("anchor", "anchor_b", "length"),
}
MOTOR_KEYS = ("target", "strength", "position", "compliance", "damping")
CONTACT_KEYS = ("name", "a", "b", "ground", "friction", "restitution", "margin", "nodes", "surface")
GROUND_KEYS = {"plane": ("point",), "heights": ("spacing", "origin")}


def read_rigid(table: Table, folder: Path) -> RigidBody:
    """The rigid body that a [[rigid]] table describes; surface files are looked for in `folder`."""
    zero = (0.0, 0.0, 0.0)
    if "orientation" in table and "rotate" in table:
        raise SceneFileError(f"{table.where} has both 'orientation' and 'rotate': give one of them")
    motion = None
    if "motion" in table:
        motion = read_motion(table.table("motion", MOTION_KEYS, f"'motion' in {table.where}"))
    return RigidBody(
        _shape(table, folder),
        density=table.number("density", None, "kg/m^3", positive=True),
        mass=table.number("mass", None, "kg", positive=True),
        position=table.vector("position", zero, "m"),
        orientation=_turn(table) if "rotate" in table else table.vector("orientation", (1.0, 0.0, 0.0, 0.0), length=4),
        velocity=table.vector("velocity", zero, "m/s"),
        angular_velocity=table.vector("angular_velocity", zero, "rad/s"),
        fixed=_flag(table, "fixed"),
        motion=motion,
        name=table.text("name", None),
    )


def read_joint(values: dict[str, Any], where: str, soft: Sequence[SoftBody]) -> Joint:
    """The joint that a [[joint]] table describes; `soft`: the scene's soft bodies, for selections of nodes."""
    kind = Table(values, where, None).choice("kind", tuple(JOINT_KEYS))
    table = Table(values, f"{where} ({kind})", (*JOINT_SHARED, *JOINT_KEYS[kind]))
    shared = {
        "compliance": table.number("compliance", 0.0),
        "damping": table.number("damping", 0.0),
        "name": table.text("name", None),
    }
    ends = table.text("a", None), table.text("b", None)
    if kind == "weld":
        nodes = _nodes(table, soft) if "nodes" in table else None
        return WeldJoint(*ends, table.vector("anchor", (0.0, 0.0, 0.0), "m"), nodes, **shared)
    anchor = table.vector("anchor", unit="m")
    if kind == "ball":
        return BallJoint(*ends, anchor, table.vector("anchor_b", None, "m"), **shared)
    if kind in ("distance", "rope"):
        length = table.number("length", None, "m")
        return DistanceJoint(*ends, anchor, table.vector("anchor_b", unit="m"), length, kind == "rope", **shared)
    limits = table.number("low", -np.inf), table.number("high", np.inf)
    motor = _motor(table) if "motor" in table else None
    joint = HingeJoint if kind == "hinge" else SliderJoint
    return joint(*ends, anchor, table.vector("axis"), *limits, motor, **shared)


def read_contact(table: Table, soft: Sequence[SoftBody], folder: Path) -> Contact:
    """The contact that a [[contact]] table describes; surface files are looked for in `folder`."""
    if ("b" in table) == ("ground" in table):
        both = "both 'b' and 'ground'" if "b" in table else "neither 'b' (a body's name) nor 'ground'"
        raise SceneFileError(f"{table.where} has {both}: give one of them")
    return Contact(
        table.text("a"),
        _ground(table) if "ground" in table else table.text("b"),
        friction=table.number("friction", 0.5),
        restitution=table.number("restitution", 0.0),
        margin=table.number("margin", None, "m", positive=True),
        nodes=_nodes(table, soft) if "nodes" in table else None,
        surface=_vertices(table, folder) if "surface" in table else None,
        name=table.text("name", None),
    )


def _shape(table: Table, folder: Path) -> Any:
    kind, shape = _one_of(table, "shape", SHAPE_KEYS, "{ sphere = 0.1 }, { box = [1, 1, 1] } or { file = 'part.stl' }")
    if kind == "sphere":
        return Sphere(shape.number("sphere", unit="m", positive=True))
    if kind == "box":
        return Box(shape.vector("box", unit="m"))
    if kind == "file":
        points, triangles = read_surface(folder / shape.text("file"))
        return TriangleMesh(shape.number("scale", 1.0, positive=True) * points, triangles)
    sizes = shape.number(kind, unit="m", positive=True), shape.number("length", unit="m", positive=True)
    return Capsule(*sizes) if kind == "capsule" else Cylinder(*sizes)


def _vertices(table: Table, folder: Path) -> Any:
    surface = table.table("surface", ("file", "scale"), f"'surface' in {table.where}")
    return read_surface(folder / surface.text("file"), surface.number("scale", 1.0, positive=True))[0]


def _ground(table: Table) -> Any:
    kind, ground = _one_of(table, "ground", GROUND_KEYS, "{ plane = [0, 0, 1] } or { heights = [[0, 0], [0, 1]] }")
    if kind == "plane":
        return Plane(ground.vector("point", (0.0, 0.0, 0.0), "m"), ground.vector("plane"))
    heights = ground.get("heights")
    rows = heights if isinstance(heights, list) and all(isinstance(row, list) for row in heights) else []
    if len(rows) < 2 or len({len(row) for row in rows}) != 1 or len(rows[0]) < 2 or not all(map(_numbers, rows)):
        raise ground.wrong("heights", "at least two rows of at least two heights in m, all of one length")
    return HeightField(
        np.array(rows, float), ground.vector("spacing", unit="m", length=2), ground.vector("origin", (0.0, 0.0), "m", 2)
    )


def _numbers(row: list[Any]) -> bool:
    return all(is_number(each) for each in row)


def _one_of(table: Table, key: str, kinds: dict[str, tuple], example: str) -> tuple[str, Table]:
    """The one kind that a table names, and that table."""
    where, raw = f"{key!r} in {table.where}", table.get(key)
    if not isinstance(raw, dict):
        raise table.wrong(key, f"a table like {example}")
    given = [kind for kind in kinds if kind in raw]
    if len(given) != 1:
        Table(raw, where, {*kinds, *(each for keys in kinds.values() for each in keys)})
        raise SceneFileError(f"{where} names {' and '.join(given) or 'no kind'}: give one of {', '.join(kinds)}")
    return given[0], Table(raw, f"{where} (a {given[0]})", (given[0], *kinds[given[0]]))


def _turn(table: Table) -> tuple[float, ...]:
    from scipy.spatial.transform import Rotation  # slow to import: only where a body is turned

    turn = table.table("rotate", ("axis", "degrees"), f"'rotate' in {table.where}")
    axis = np.array(turn.vector("axis"))
    if not axis.any():
        raise turn.wrong("axis", "a direction, not all zeros")
    vector = axis / np.linalg.norm(axis) * np.radians(turn.number("degrees"))
    x, y, z, w = Rotation.from_rotvec(vector).as_quat()
    return (float(w), float(x), float(y), float(z))


def _motor(table: Table) -> Motor:
    motor = table.table("motor", MOTOR_KEYS, f"'motor' in {table.where}")
    return Motor(
        motor.number("target"),
        motor.number("strength"),
        _flag(motor, "position"),
        motor.number("compliance", 0.0),
        motor.number("damping", 0.0),
    )


def _nodes(table: Table, soft: Sequence[SoftBody]) -> Any:
    name = table.text("a")
    for body in soft:
        if body.label == name:
            return select_nodes(table, "nodes", body.mesh)
    known = ", ".join(f'"{body.label}"' for body in soft) or "none"
    raise SceneFileError(f"'nodes' in {table.where} are those of a soft body, but 'a' is \"{name}\": they are {known}")


def _flag(table: Table, key: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise table.wrong(key, "true or false")
    return value
