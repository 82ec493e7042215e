"""Selections of nodes and faces in scene files: named groups, and boxes or half-spaces in the undeformed mesh."""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxfem.io.toml_tables import SceneFileError, Table, is_integer
from jaxfem.mesh import MeshError, TetMesh

SELECTOR_KEYS = ("box", "below", "above", "nodes")
SLACK = 1e-9  # of the mesh's size: a limit given to a few digits should hold the nodes on it


def select_nodes(table: Table, key: str, mesh: TetMesh) -> np.ndarray:
    """Sorted node numbers (k,) that the selection `key` of a table names.

    A selection is a group's name, a table, or a list of such, joined. Tables: { box = [[x, y, z], [x, y, z]] },
    { below = { z = 0.01 } }, { above = { x = 0.1 } }, { nodes = [0, 1] }; with several keys, what meets all of them.
    SceneFileError when it selects nothing or names an unknown group.
    """
    return np.flatnonzero(_mask(table, key, mesh))


def select_faces(table: Table, key: str, mesh: TetMesh) -> np.ndarray:
    """Surface triangles (k, 3) of a selection: those of named face groups, and those with all nodes in a region."""
    chosen = []
    for part in _parts(table, key):
        if isinstance(part, str):
            chosen.append(_group(mesh.faces, part, f"{key!r} in {table.where}"))
        else:
            inside = _region(part, f"{key!r} in {table.where}", mesh)
            chosen.append(mesh.surface[inside[mesh.surface].all(axis=1)])
    faces = np.concatenate(chosen)
    if not len(faces):
        raise _nothing(table, key, mesh, "face of the surface")
    # a face in two of the joined parts must not carry the load twice
    return faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]


def _mask(table: Table, key: str, mesh: TetMesh) -> np.ndarray:
    chosen = np.zeros(len(mesh.points), bool)
    where = f"{key!r} in {table.where}"
    for part in _parts(table, key):
        if isinstance(part, str):
            chosen[_group(mesh.nodes, part, where)] = True
        else:
            chosen |= _region(part, where, mesh)
    if not chosen.any():
        raise _nothing(table, key, mesh, "node")
    return chosen


def _parts(table: Table, key: str) -> list[Any]:
    value = table.get(key)
    parts = value if isinstance(value, list) else [value]
    if not parts or not all(isinstance(part, str | dict) for part in parts):
        raise table.wrong(key, "a group's name, a selector like { below = { z = 0.01 } }, or a list of these")
    return parts


def _group(find: Callable[[str], np.ndarray], name: str, where: str) -> np.ndarray:
    try:
        return find(name)
    except MeshError as problem:
        raise SceneFileError(f"{where}: {problem}") from problem


def _region(values: dict[str, Any], where: str, mesh: TetMesh) -> np.ndarray:
    """Mask (n,) of the nodes that meet every condition of one selector table."""
    table = Table(values, where, SELECTOR_KEYS)
    if not values:
        raise SceneFileError(f"{where} is an empty selector: give one of {', '.join(SELECTOR_KEYS)}")
    points, slack = mesh.points, SLACK * float(np.ptp(mesh.points, axis=0).max())
    inside = np.ones(len(points), bool)
    if "box" in table:
        low, high = _corners(table)
        inside &= ((points >= low - slack) & (points <= high + slack)).all(axis=1)
    for key, sign in (("below", 1.0), ("above", -1.0)):
        limits = table.table(key, ("x", "y", "z"), f"{key!r} of {where}")
        for axis in limits.values:
            place = points[:, "xyz".index(axis)]
            inside &= sign * (place - limits.number(axis, unit="m")) <= slack
    if "nodes" in table:
        inside &= _listed(table, len(points))
    return inside


def _corners(table: Table) -> tuple[np.ndarray, np.ndarray]:
    corners = table.get("box")
    if not (isinstance(corners, list) and len(corners) == 2):
        raise table.wrong("box", "two corners [[x, y, z], [x, y, z]] in m")
    pair = Table(dict(zip(("low", "high"), corners, strict=True)), f"'box' of {table.where}", None)
    low, high = np.array(pair.vector("low", unit="m")), np.array(pair.vector("high", unit="m"))
    if (low > high).any():
        raise table.wrong("box", "the smaller corner, then the larger one")
    return low, high


def _listed(table: Table, count: int) -> np.ndarray:
    numbers = table.get("nodes")
    if not (isinstance(numbers, list) and all(is_integer(each) and 0 <= each < count for each in numbers)):
        raise table.wrong("nodes", f"a list of node numbers from 0 to {count - 1}")
    mask = np.zeros(count, bool)
    mask[np.array(numbers, int)] = True
    return mask


def _nothing(table: Table, key: str, mesh: TetMesh, what: str) -> SceneFileError:
    low, high = mesh.bounds
    reach = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", low, high, strict=True))
    return SceneFileError(f'{key!r} in {table.where} selects no {what}: "{mesh.name}" reaches from {reach} m')
