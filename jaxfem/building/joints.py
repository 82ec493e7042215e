"""Declared joints as groups of rows: all parts of one kind and one pair of attachments in one set of arrays."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.declared import (
    BallJoint,
    DistanceJoint,
    HingeJoint,
    Joint,
    SceneError,
    SliderJoint,
    WeldJoint,
)
from jaxfem.rows.coordinates import (
    Angle,
    Distance,
    LengthValues,
    Limit,
    LimitValues,
    Motor,
    MotorValues,
    Separation,
    Travel,
)
from jaxfem.rows.locks import AxisLock, FrameLock, LineLock, PointLock, Softness


class Part(NamedTuple):
    """One joint's part: a word for its kind, its rows' arrays, its values."""

    word: str
    rows: Any
    values: Any
    name: str


def joint_parts(joints: Sequence[Joint], index: BodyIndex, dtype: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Groups of joint rows and their values, both by name: a word and the kinds of attachment, "point rigid-world".

    In each group `names` says which joint each entry is of: its own name, or its place in the scene's list.
    """
    grouped: dict[str, list[Part]] = {}
    for number, joint in enumerate(joints):
        for part in _parts(joint, index, joint.name or str(number)):
            grouped.setdefault(f"{part.word} {_kinds(part.rows)}", []).append(part)
    rows, values = {}, {}
    for label, parts in grouped.items():
        stacked = _stacked([part.rows for part in parts], dtype)
        rows[label] = stacked.replace(names=tuple(part.name for part in parts))
        values[label] = _stacked([part.values for part in parts], dtype)
    return rows, values


def _stacked(trees: list[Any], dtype: Any) -> Any:
    def stack(*leaves: Any) -> jax.Array:
        array = np.stack([np.asarray(leaf) for leaf in leaves])
        return jnp.asarray(array, jnp.int32 if np.issubdtype(array.dtype, np.integer) else dtype)

    return jax.tree.map(stack, *trees)


def _kinds(rows: Any) -> str:
    """Kinds of attachment of a part, a's and b's: "rigid-world"."""
    holder = getattr(rows, "coordinate", rows)
    return f"{holder.a.kind}-{holder.b.kind}"


def _parts(joint: Joint, index: BodyIndex, name: str) -> Iterator[Part]:
    soft = Softness(float(joint.compliance), float(joint.damping))
    where = f'joint "{name}"' if joint.name else f"joint {name} (a {type(joint).__name__})"
    if isinstance(joint, BallJoint):
        other = joint.anchor if joint.anchor_b is None else joint.anchor_b
        lock = PointLock(index.point(joint.a, joint.anchor, where), index.point(joint.b, other, where))
        yield Part("point", lock, soft, name)
    elif isinstance(joint, WeldJoint):
        yield from _weld(joint, index, where, name, soft)
    elif isinstance(joint, DistanceJoint):
        ends = index.point(joint.a, joint.anchor, where), index.point(joint.b, joint.anchor_b, where)
        values = LengthValues(joint.rest_length, soft.compliance, soft.damping)
        yield Part("rope" if joint.rope else "distance", Distance(Separation(*ends), rope=joint.rope), values, name)
    elif isinstance(joint, HingeJoint | SliderJoint):
        yield from _axis(joint, index, where, name, soft)
    else:
        raise SceneError(f"{where} is no joint: a scene's joints are BallJoint, HingeJoint, SliderJoint, ...")


def _weld(joint: WeldJoint, index: BodyIndex, where: str, name: str, soft: Softness) -> Iterator[Part]:
    kind, number = index.find(joint.a, where)
    if kind != "soft":
        if joint.nodes is not None:
            raise SceneError(f"{where} names nodes, which belong to a soft body: make that one `a`")
        axes = np.eye(3)
        lock = PointLock(index.point(joint.a, joint.anchor, where), index.point(joint.b, joint.anchor, where))
        yield Part("point", lock, soft, name)
        frames = index.frame(joint.a, axes, where), index.frame(joint.b, axes, where)
        yield Part("frame", FrameLock(*frames), soft, name)
        return
    if joint.nodes is None:
        raise SceneError(f'{where} welds a soft body: give the `nodes` that it ties, like nodes="x+"')
    body = index.soft[number]
    chosen = body.nodes_of("nodes of a weld", joint.nodes)
    if not len(chosen):
        raise SceneError(f"{where} ties no node: its selection of nodes is empty")
    for node in chosen:
        place = body.mesh.points[node]
        a = index.point(joint.a, place, where)
        yield Part("point", PointLock(a, index.point(joint.b, place, where)), soft, name)


def _axis(joint: Any, index: BodyIndex, where: str, name: str, soft: Softness) -> Iterator[Part]:
    axes = frame_along(np.asarray(joint.axis, float))
    frames = index.frame(joint.a, axes, where), index.frame(joint.b, axes, where)
    points = index.point(joint.a, joint.anchor, where), index.point(joint.b, joint.anchor, where)
    coordinate: Any
    if isinstance(joint, HingeJoint):
        yield Part("point", PointLock(*points), soft, name)
        yield Part("axis", AxisLock(*frames), soft, name)
        coordinate, word = Angle(*frames), "angle"
    else:
        yield Part("line", LineLock(*points, frames[0]), soft, name)
        yield Part("frame", FrameLock(*frames), soft, name)
        coordinate, word = Travel(*points, frames[0]), "travel"
    if np.isfinite([joint.low, joint.high]).any():
        yield Part(f"{word} limit", Limit(coordinate), LimitValues(joint.low, joint.high, 0.0, 0.0), name)
    if joint.motor is not None:
        motor = joint.motor
        values = MotorValues(motor.target, motor.strength, motor.compliance, motor.damping)
        kind = f"{word} position motor" if motor.position else f"{word} motor"
        yield Part(kind, Motor(coordinate, position=motor.position), values, name)


def frame_along(axis: np.ndarray) -> np.ndarray:
    """A right-handed orthonormal frame (3, 3), columns, whose third axis is along `axis`."""
    third = axis / np.linalg.norm(axis)
    spare = np.eye(3)[np.argmin(np.abs(third))]
    first = np.cross(spare, third)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third], -1)
