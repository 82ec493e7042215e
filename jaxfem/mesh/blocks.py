"""Sorting out what a mesh file holds: tetrahedra kept, tagged triangles, lines and vertices made groups."""

import dataclasses
from typing import Any

import numpy as np

from .checks import Floats, Ints, MeshError

LINEAR = {  # cell types in use: how many of their nodes are corners, and their dimension
    "tetra": (4, 3),
    "tetra10": (4, 3),
    "triangle": (3, 2),
    "triangle6": (3, 2),
    "line": (2, 1),
    "line3": (2, 1),
    "vertex": (1, 0),
}
TAGS = (
    "gmsh:physical",
    "medit:ref",
    "tetgen:ref",
    "nastran:ref",
    "su2:tag",
)  # where formats keep a cell's group number


@dataclasses.dataclass
class Parts:
    """What was found in a file: points (n, 3), elements (m, 4) and groups, in the numbering of the file."""

    points: Floats
    cells: Ints
    face_groups: dict[str, Ints]
    node_groups: dict[str, Ints]
    cell_groups: dict[str, Ints]
    notes: tuple[str, ...]


def sort_out(raw: Any, source: str) -> Parts:
    """The usable parts of a meshio mesh; MeshError when it holds no tetrahedra, saying what it holds instead."""
    blocks = [(block.type, block.data) for block in raw.cells]
    if not any(kind in ("tetra", "tetra10") and len(data) for kind, data in blocks):
        raise MeshError(_no_tetrahedra(blocks, source))
    corners = {dim: _stacked(blocks, dim) for dim in range(4)}
    named: dict[int, dict[str, Ints]] = {dim: {} for dim in range(4)}
    for dim in range(4):
        for name, chosen in {**_by_tag(raw, blocks, dim), **_by_set(raw, blocks, dim)}.items():
            named[dim][name] = chosen
    nodes = {name: np.unique(corners[dim][chosen]) for dim in (0, 1) for name, chosen in named[dim].items()}
    nodes |= {str(name): np.asarray(numbers, dtype=np.int64) for name, numbers in raw.point_sets.items()}
    return Parts(
        points=solid_points(raw.points),
        cells=corners[3],
        face_groups={name: corners[2][chosen] for name, chosen in named[2].items()},
        node_groups=nodes,
        cell_groups=named[3],
        notes=_notes(blocks, named),
    )


def solid_points(points: Any) -> Floats:
    """Points as (n, 3): a plane file's get z = 0."""
    array = np.asarray(points, dtype=np.float64)
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1]))) if array.ndim == 2 and array.shape[1] < 3 else array


def _stacked(blocks: list[tuple[str, Any]], dim: int) -> Ints:
    """The corner nodes of all cells of one dimension, block after block."""
    rows = [np.asarray(data, dtype=np.int64)[:, : LINEAR[kind][0]] for kind, data in blocks if _has(kind, dim)]
    return np.concatenate(rows) if rows else np.zeros((0, dim + 1), dtype=np.int64)


def _has(kind: str, dim: int) -> bool:
    return kind in LINEAR and LINEAR[kind][1] == dim


def _by_tag(raw: Any, blocks: list[tuple[str, Any]], dim: int) -> dict[str, Ints]:
    """Numbers of the cells of one dimension that share a tag, under the tag's name in the file, or else its number."""
    for key in TAGS:
        if key not in raw.cell_data:
            continue
        found = [values for (kind, _), values in zip(blocks, raw.cell_data[key], strict=True) if _has(kind, dim)]
        tags = np.concatenate(found).astype(np.int64) if found else np.zeros(0, dtype=np.int64)
        # Gmsh's own field_data: name -> (number, dimension)
        names = {int(v[0]): str(k) for k, v in raw.field_data.items() if np.size(v) == 2 and int(v[1]) == dim}
        values = [int(tag) for tag in np.unique(tags) if tag != 0]
        if dim != 2 and not names and (len(values) < 2 or dim < 2):
            return {}  # one number on everything says nothing
        return {names.get(tag, str(tag)): np.flatnonzero(tags == tag) for tag in values}
    return {}


def _by_set(raw: Any, blocks: list[tuple[str, Any]], dim: int) -> dict[str, Ints]:
    """Numbers of the cells of one dimension in each of the file's own cell sets."""
    groups: dict[str, Ints] = {}
    for name, members in raw.cell_sets.items():
        if name.startswith("gmsh:"):
            continue
        chosen, start = [], 0
        for (kind, data), numbers in zip(blocks, members, strict=True):
            if _has(kind, dim):
                chosen += [start + np.asarray(numbers, dtype=np.int64)] if numbers is not None else []
                start += len(data)
        if sum(len(numbers) for numbers in chosen):
            groups[str(name)] = np.concatenate(chosen)
    return groups


def _notes(blocks: list[tuple[str, Any]], named: dict[int, dict[str, Ints]]) -> tuple[str, ...]:
    notes = []
    quadratic = sum(len(data) for kind, data in blocks if kind == "tetra10")
    if quadratic:
        notes.append(f"{quadratic} quadratic elements were made linear: their nodes on edges are left out")
    rest = {
        kind: sum(len(data) for other, data in blocks if other == kind)
        for kind, _ in blocks
        if kind not in LINEAR or (LINEAR[kind][1] < 3 and not named[LINEAR[kind][1]])
    }
    if rest:
        notes.append(f"left out: {_inventory(rest)} (no tetrahedra, no group)")
    return tuple(notes)


def _inventory(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in counts.items())


def _no_tetrahedra(blocks: list[tuple[str, Any]], source: str) -> str:
    counts = {kind: sum(len(data) for other, data in blocks if other == kind) for kind, _ in blocks}
    counts = {kind: count for kind, count in counts.items() if count}
    found = _inventory(counts) or "no cells at all"
    if (
        counts
        and all(LINEAR.get(kind, (0, 3))[1] <= 2 for kind in counts)
        and any("triangle" in kind for kind in counts)
    ):
        return (
            f"no tetrahedra in {source}: it holds a surface ({found}), which has no volume: fill a convex one with "
            f"jaxfem.mesh.from_convex_surface(*jaxfem.mesh.read_surface({source!r})), or mesh its volume with a mesher "
            "such as Gmsh or TetGen"
        )
    return f"no tetrahedra in {source}: found {found}; mesh the volume with tetrahedra"
