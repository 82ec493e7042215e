"""Sorting out what a mesh file holds: solids made tetrahedra; tagged triangles, lines and vertices made groups."""

import dataclasses
from pathlib import Path

import numpy as np

from .checks import Floats, Ints, MeshError
from .cutting import cut_solids
from .diagonals import Diagonals, diagonals
from .raw import CORNERS, RawMesh, dimension, shape_of

FLAT_KINDS = ("polygon", "polyline", "polyvertex", "strip", "empty")  # unknown kinds of cells that have no volume


@dataclasses.dataclass
class Parts:
    """What was found in a file: points (n, 3), elements (m, 4) and groups, in the numbering of the file."""

    points: Floats
    cells: Ints
    face_groups: dict[str, Ints]
    node_groups: dict[str, Ints]
    cell_groups: dict[str, Ints]
    notes: tuple[str, ...]


def sort_out(raw: RawMesh, source: str) -> Parts:
    """The usable parts of a file; MeshError when it holds no solids, or some that cannot be cut into tetrahedra."""
    if not any(dimension(kind) == 3 for kind, _ in raw.blocks):
        raise MeshError(_no_solids(raw, source))
    strange = [kind for kind, _ in raw.blocks if shape_of(kind) is None and not kind.startswith(FLAT_KINDS)]
    if strange:
        found = _inventory({kind: count for kind, count in _counts(raw).items() if kind in strange})
        raise MeshError(
            f"{source} holds {found}, which cannot be cut into tetrahedra here: leaving them out would leave holes; "
            "mesh with tetrahedra, hexahedra, wedges or pyramids"
        )
    corners = [_corners(kind, rows) for kind, rows in raw.blocks]
    solids = {shape: [corners[i] for i in _of_shape(raw, shape)] for shape, (_, dim) in CORNERS.items() if dim == 3}
    rule = diagonals(len(raw.points), {shape: np.concatenate(own) for shape, own in solids.items() if own})
    points, cells, cell_groups, notes = _solids(raw, corners, rule, source)
    faces = _faces(raw, corners, rule)
    nodes: dict[str, list[Ints]] = {name: [np.asarray(own, np.int64)] for name, own in raw.node_sets.items()}
    for name, members in raw.cell_sets.items():
        for block, chosen in members:
            if dimension(raw.blocks[block][0]) in (0, 1):
                nodes.setdefault(name, []).append(corners[block][chosen].reshape(-1))
    return Parts(
        points=points,
        cells=cells,
        face_groups=faces,
        node_groups={name: np.unique(np.concatenate(each)) for name, each in nodes.items()},
        cell_groups=cell_groups,
        notes=(*raw.notes, *notes, *_notes(raw)),
    )


def surface_of(raw: RawMesh) -> Ints:
    """All triangles (k, 3) of a file, quadrilaterals cut in two; (0, 3) where there are none."""
    rule = diagonals(len(raw.points), {})
    rows = [rule.triangles(_corners(kind, rows)).reshape(-1, 3) for kind, rows in raw.blocks if dimension(kind) == 2]
    return np.concatenate([np.zeros((0, 3), np.int64), *rows])


def _corners(kind: str, rows: Ints) -> Ints:
    shape = shape_of(kind)
    return rows if shape is None else rows[:, : CORNERS[shape][0]]


def _of_shape(raw: RawMesh, shape: str) -> list[int]:
    return [i for i, (kind, _) in enumerate(raw.blocks) if shape_of(kind) == shape]


def _solids(
    raw: RawMesh, corners: list[Ints], rule: Diagonals, source: str
) -> tuple[Floats, Ints, dict[str, Ints], tuple[str, ...]]:
    """Points, tetrahedra and groups of them. Blocks of one shape are cut together, so that each is told once."""
    points, made, notes = raw.points, list[Ints](), list[str]()
    place: dict[int, tuple[int, Ints]] = {}  # of a block: its first element, and the cell of each element
    start = 0
    for shape in (shape for shape, (_, dim) in CORNERS.items() if dim == 3):
        own = _of_shape(raw, shape)
        if not own:
            continue
        cut = cut_solids(shape, np.concatenate([corners[i] for i in own]), points, rule, source)
        points = cut.points
        order = np.argsort(cut.parents, kind="stable")
        made.append(cut.tets[order])
        notes += cut.notes
        parents, first = cut.parents[order], 0
        for i in own:
            low, high = np.searchsorted(parents, [first, first + len(corners[i])])
            place[i] = (start + int(low), parents[low:high] - first)
            first += len(corners[i])
        start += len(parents)
    groups: dict[str, list[Ints]] = {}
    for name, members in raw.cell_sets.items():
        for block, chosen in members:
            if block in place:
                first, parents = place[block]
                groups.setdefault(name, []).append(first + np.flatnonzero(np.isin(parents, chosen)))
    joined = {name: np.unique(np.concatenate(each)) for name, each in groups.items()}
    return points, np.concatenate(made), joined, tuple(notes)


def _faces(raw: RawMesh, corners: list[Ints], rule: Diagonals) -> dict[str, Ints]:
    """Groups of triangles: sets of surface cells, and of faces."""
    groups = {
        name: [rule.triangles(np.asarray(rows, np.int64)).reshape(-1, 3) for rows in faces]
        for name, faces in raw.face_sets.items()
    }
    for name, members in raw.cell_sets.items():
        for block, chosen in members:
            if dimension(raw.blocks[block][0]) == 2:
                groups.setdefault(name, []).append(rule.triangles(corners[block][chosen]).reshape(-1, 3))
    joined = {name: np.concatenate([np.zeros((0, 3), np.int64), *each]) for name, each in groups.items()}
    # a file may hold a face from both sides
    return {
        name: rows[np.sort(np.unique(np.sort(rows, axis=1), axis=0, return_index=True)[1])]
        for name, rows in joined.items()
    }


def _notes(raw: RawMesh) -> tuple[str, ...]:
    notes = []
    quadratic = sum(
        len(rows)
        for kind, rows in raw.blocks
        if dimension(kind) == 3 and rows.shape[1] > CORNERS[shape_of(kind) or ""][0]
    )
    if quadratic:
        made = "1 quadratic element was" if quadratic == 1 else f"{quadratic} quadratic elements were"
        notes.append(f"{made} made linear: nodes on edges are left out, and curved edges straight")
    used = {dimension(raw.blocks[block][0]) for members in raw.cell_sets.values() for block, _ in members}
    rest = {
        kind: count
        for kind, count in _counts(raw).items()
        if shape_of(kind) is None or (dimension(kind) != 3 and dimension(kind) not in used)
    }
    rest |= raw.left_out
    if rest:
        notes.append(f"left out: {_inventory(rest)} (no solids, no group)")
    return tuple(notes)


def _counts(raw: RawMesh) -> dict[str, int]:
    counts: dict[str, int] = {}
    for kind, rows in raw.blocks:
        counts[kind] = counts.get(kind, 0) + len(rows)
    return counts


def _inventory(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in counts.items())


def _no_solids(raw: RawMesh, source: str) -> str:
    counts = _counts(raw)
    found = _inventory(counts | raw.left_out) or "no cells at all"
    if any(dimension(kind) == 2 for kind in counts) and all(dimension(kind) is not None for kind in counts):
        return (
            f"no tetrahedra in {source}: it holds a surface ({found}), which has no volume: fill it with "
            f"jaxfem.mesh.from_surface(*jaxfem.mesh.read_surface({source!r})), `jaxfem mesh make` or, in a scene file, "
            f'mesh = {{ surface = "{Path(source).name}" }} (a convex one with from_convex_surface, which needs nothing '
            "else), or with a mesher such as Gmsh"
        )
    return f"no tetrahedra in {source}: found {found}; mesh the volume with tetrahedra"
