"""Abaqus and CalculiX input files (.inp): parts and their instances, sets, surfaces.

Sets and surfaces of the assembly, or of a file without parts, keep their names. Those of an instance are there as
INSTANCE.NAME and, joined over all instances, as NAME; where there are several instances, each is a set of its elements.
"""

import dataclasses
from pathlib import Path

import numpy as np

from ..checks import Floats, MeshError
from ..raw import RawMesh
from .abaqus_model import Model
from .abaqus_parts import Part
from .abaqus_text import Keyword, fields, keywords

ENDS = {"END PART", "END INSTANCE", "END ASSEMBLY"}


@dataclasses.dataclass
class Instance:
    """A part in its place: `lines` of *INSTANCE say the way it is moved, then turned."""

    name: str
    part: str
    own: Part
    lines: list[str]


def read_abaqus(path: Path) -> RawMesh:
    """The whole model of the file, its instances in their places."""
    top, parts, instances = _parsed(path)
    model = Model()
    model.place("", top, lambda points: points)
    if parts and not instances:  # a library of parts, or a file cut short of its assembly: each where it is
        instances = [Instance(part.name, part.name, Part(part.name), []) for part in parts.values()]
    for each in instances:
        if each.part.upper() not in parts:
            raise MeshError(f'*INSTANCE "{each.name}" is of part "{each.part}", which the file does not hold')
        model.place(each.name, _joined(parts[each.part.upper()], each.own), lambda p, i=each: _placed(p, i))  # type: ignore[misc]
    used = {each.part.upper() for each in instances}
    raw = model.mesh()
    idle = [part.name for key, part in parts.items() if key not in used]
    if idle:
        raw.notes.append(f"left out: part {', '.join(idle)}, of which the assembly has no instance")
    return raw


def _parsed(path: Path) -> tuple[Part, dict[str, Part], list[Instance]]:
    """What stands outside parts, the parts by name in capitals, and the instances."""
    top, parts, instances = Part(""), dict[str, Part](), list[Instance]()
    here, found = top, False
    for keyword in keywords(path):
        found = True
        if keyword.word == "PART":
            here = parts.setdefault(keyword.parameter("NAME").upper(), Part(keyword.parameter("NAME")))
        elif keyword.word == "INSTANCE":
            instances.append(_instance(keyword))
            here = instances[-1].own
        elif keyword.word in ENDS:
            here = top
        elif keyword.word == "STEP":
            break  # loads and results: nothing of the mesh
        else:
            here.add(keyword)
    if not found:
        raise MeshError("it has no keywords")
    return top, parts, instances


def _instance(keyword: Keyword) -> Instance:
    if "LIBRARY" in keyword.parameters:
        raise MeshError(f"line {keyword.line}: *INSTANCE from a library needs results of another job")
    name = keyword.parameter("NAME")
    return Instance(name, keyword.parameter("PART"), Part(name), keyword.lines)


def _joined(part: Part, own: Part) -> Part:
    """A part with what its instance adds: a mesh of its own, sets."""
    joined = Part(own.name)
    for field in dataclasses.fields(Part)[1:]:
        mine, more = getattr(part, field.name), getattr(own, field.name)
        setattr(joined, field.name, [*mine, *more] if isinstance(mine, list) else {**mine, **more})
    return joined


def _placed(points: Floats, instance: Instance) -> Floats:
    """Points moved by the first line of *INSTANCE, then turned by the second: two points of the axis, degrees."""
    try:
        rows = [[float(word or 0) for word in fields(line)] for line in instance.lines]
    except ValueError as problem:
        raise MeshError(f'*INSTANCE "{instance.name}": {problem}') from problem
    if rows:
        points = points + np.array((rows[0] + [0.0] * 3)[:3])
    if len(rows) > 1:
        first, second, degrees = np.array(rows[1][:3]), np.array(rows[1][3:6]), np.array(rows[1][6:7])
        axis = second - first if len(rows[1]) == 7 else np.zeros(3)
        if not axis.any():
            raise MeshError(f'*INSTANCE "{instance.name}": its turn needs two different points and an angle in degrees')
        x, y, z = axis / np.linalg.norm(axis)
        cross, angle = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), float(np.radians(degrees[0]))
        # Rodrigues' rotation about an axis of unit length
        turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        points = (points - first) @ turn.T + first
    return points
