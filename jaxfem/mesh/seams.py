"""Nodes that lie on top of another, as along a seam between parts: found, and made one."""

from typing import Any

import numpy as np

from .checks import Floats, Ints, MeshError, edge_lengths, is_positive
from .raw import CORNERS, RawMesh, shape_of
from .tet import TetMesh
from .topology import first_of_each

CLOSE = 1e-6  # of the mesh's size: nodes nearer than that are taken to be the same
OF_EDGE = 0.01  # but never more than this share of the shortest edge
DIRECTION = np.array([0.5773, 0.5211, 0.6287])  # no plane or line of nodes of a usual mesh is across it


def reach_of(points: Floats, shortest: float) -> float:
    """Distance [m] below which two nodes are the same, in a mesh whose shortest edge is `shortest`."""
    return min(CLOSE * float(np.linalg.norm(np.ptp(points, axis=0))), OF_EDGE * shortest)


def close_pairs(points: Floats, reach: float) -> Ints:
    """Pairs (k, 2) of nodes at most `reach` [m] apart.

    Sorted along one oblique direction, nodes that are close are neighbours or nearly so: no tree is needed.
    """
    along = points @ (DIRECTION / np.linalg.norm(DIRECTION))
    order = np.argsort(along, kind="stable")
    pairs = [np.zeros((0, 2), np.int64)]
    rows = np.arange(len(points))
    for step in range(1, len(points)):
        rows = rows[rows + step < len(points)]
        rows = rows[along[order[rows + step]] - along[order[rows]] <= reach]
        if not len(rows):
            break
        a, b = order[rows], order[rows + step]
        near = np.linalg.norm(points[a] - points[b], axis=1) <= reach
        pairs.append(np.stack([a[near], b[near]], axis=1))
    return np.concatenate(pairs)


def merge_distance(merge: Any, what: str) -> float | None:
    """The distance [m] that `merge` asks for: None for False, 0.0 for True (found from the mesh), or itself."""
    if isinstance(merge, bool | np.bool_):
        return 0.0 if merge else None
    if not is_positive(merge):
        raise MeshError(f"merge={merge!r} for {what}: give true, false or a distance in m, above zero")
    return float(merge)


def merged(raw: RawMesh, distance: float) -> RawMesh:
    """The file's mesh with nodes at most `distance` apart (0: found from the mesh) made one, and a note of how many."""
    first, note = _joined(raw.points, distance or reach_of(raw.points, _shortest_edge(raw)))
    raw.points, new = _without_merged(raw.points, first)
    place = new[first]
    raw.blocks = [(kind, place[rows]) for kind, rows in raw.blocks]
    raw.node_sets = {name: np.unique(place[numbers]) for name, numbers in raw.node_sets.items()}
    raw.face_sets = {name: [place[rows] for rows in faces] for name, faces in raw.face_sets.items()}
    raw.notes.append(note)
    return raw


def merged_nodes(mesh: TetMesh, distance: float) -> TetMesh:
    """See `TetMesh.merged`."""
    if distance != 0 and not is_positive(distance):
        raise MeshError(f'distance {distance!r} to merge nodes of "{mesh.name}" within: give a number above zero, in m')
    shortest = float(edge_lengths(mesh.points, mesh.cells).min())
    first, note = _joined(mesh.points, distance or reach_of(mesh.points, shortest))
    points, new = _without_merged(mesh.points, first)
    place = new[first]
    faces = {name: place[rows] for name, rows in mesh.face_groups.items()}
    nodes = {name: np.unique(place[numbers]) for name, numbers in mesh.node_groups.items()}
    notes = (*mesh.notes, note)
    return TetMesh.repaired(points, place[mesh.cells], mesh.name, faces, nodes, mesh.cell_groups, notes)


def _joined(points: Floats, distance: float) -> tuple[Ints, str]:
    """For each node the one that it becomes, and the note that says how many changed."""
    first = first_of_each(len(points), close_pairs(points, distance))
    count = int((first != np.arange(len(first))).sum())
    if not count:
        return first, f"no node lies within {distance:.2g} m of another: nothing to merge"
    were = "1 node was" if count == 1 else f"{count} nodes were"
    return first, f"{were} merged with another within {distance:.2g} m"


def _without_merged(points: Floats, first: Ints) -> tuple[Floats, Ints]:
    """The points that are left, and for each of them its new number."""
    keep = first == np.arange(len(first))
    return points[keep], np.cumsum(keep) - 1


def _shortest_edge(raw: RawMesh) -> float:
    """The shortest edge of any cell that is longer than rounding."""
    least = np.inf
    small = CLOSE * 1e-3 * float(np.linalg.norm(np.ptp(raw.points, axis=0)))
    for kind, rows in raw.blocks:
        shape = shape_of(kind)
        if shape is None or CORNERS[shape][1] != 3:
            continue
        corners = raw.points[rows[:, : CORNERS[shape][0]]]
        for gap in range(1, corners.shape[1]):
            lengths = np.linalg.norm(corners[:, gap:] - corners[:, :-gap], axis=2)
            least = min(least, float(lengths[lengths > small].min(initial=np.inf)))
    return least
