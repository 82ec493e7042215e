"""Hexahedra, wedges and pyramids cut into tetrahedra, and quadrilaterals into triangles, so that neighbours fit.

Each cell is cut from its first corner in one order of all nodes: every face of it without that corner is cut from its
own first corner, and each triangle joined to the first (Dompierre, Labbe, Vallet, Camarero, 1999: "How to subdivide
pyramids, prisms and hexahedra into tetrahedra"). A face is cut alike from both sides, as its nodes are in one order.
Where a warped cell would get a piece turned inside out, its centre becomes a node instead, joined to all faces.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .checks import FLAT, Floats, Ints, Mask, MeshError, repeated_nodes, signed_volumes
from .raw import CORNERS

FACES: dict[str, tuple[tuple[int, ...], ...]] = {  # outward, in the node order of Abaqus and Gmsh
    "tetra": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
EDGES_OF_HEXAHEDRON = np.array([*zip(range(4), (1, 2, 3, 0), strict=True)])
PLURALS = {"hexahedron": "hexahedra", "wedge": "wedges", "pyramid": "pyramids"}


@dataclasses.dataclass
class Pieces:
    """Tetrahedra (t, 4), the cell (t,) of which each is a piece, the points with any new ones, and what to say."""

    tets: Ints
    parents: Ints
    points: Floats
    notes: tuple[str, ...] = ()


def node_order(count: int, hexahedra: Sequence[Ints]) -> Ints:
    """A rank (n,) for each node by which neighbours agree on how to cut a face.

    Where nodes of hexahedra can be coloured like a chessboard, one colour comes first: diagonals then alternate, and a
    body of bricks does not lean to one side. Within a colour the file's order holds.
    """
    colour = np.zeros(count, dtype=np.int64)
    if hexahedra:
        from scipy.sparse import coo_matrix  # slow to import: only where there are hexahedra
        from scipy.sparse.csgraph import connected_components

        rings = np.concatenate([EDGES_OF_HEXAHEDRON, EDGES_OF_HEXAHEDRON + 4, [[0, 4], [1, 5], [2, 6], [3, 7]]])
        a, b = np.concatenate([cells[:, rings].reshape(-1, 2) for cells in hexahedra]).T
        # The double cover: a walk of one edge changes sides, so that both sides of a node are joined by odd rings alone
        rows, columns = np.concatenate([a, b]), np.concatenate([b, a]) + count
        graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
        label = connected_components(graph, directed=False)[1]
        colour = (label[:count] > label[count:]).astype(np.int64)
    rank = np.empty(count, dtype=np.int64)
    rank[np.lexsort((np.arange(count), colour))] = np.arange(count)
    return rank


def cut_faces(faces: Ints, rank: Ints) -> Ints:
    """Triangles of faces (k, 3) or (k, 4), each quadrilateral cut from its first corner: (k, 1 or 2, 3)."""
    if faces.shape[1] == 3:
        return faces[:, None]
    even = rank[faces].argmin(axis=1) % 2 == 0
    return np.where(even[:, None, None], faces[:, [[0, 1, 2], [0, 2, 3]]], faces[:, [[1, 2, 3], [1, 3, 0]]])


def cut_solids(shape: str, cells: Ints, points: Floats, rank: Ints, source: str) -> Pieces:
    """The tetrahedra of cells (m, corners) of one shape; volumes are kept, and each piece has its cell's orientation.

    MeshError for a cell so twisted that it has no inside.
    """
    if shape == "tetra":
        return Pieces(cells, np.arange(len(cells)), points)
    pieces = _from_first_corner(shape, cells, rank)
    small = FLAT * np.ptp(points[cells], axis=1).max(axis=1)[:, None] ** 3
    pieces, mixed, turned = _turned(pieces, points, small)
    parents = np.arange(len(cells))[:, None].repeat(pieces.shape[1], 1)
    tets, owners = pieces[~mixed].reshape(-1, 4), parents[~mixed].reshape(-1)
    warped = np.flatnonzero(mixed)
    if len(warped):
        fans, points = _around_centres(shape, cells[warped], points, rank)
        fans, twisted, _ = _turned(fans, points, small[warped])
        if twisted.any():
            bad = int(warped[np.flatnonzero(twisted)[0]])
            raise MeshError(
                f"{shape} {bad} of {source} is turned inside out in part (nodes {cells[bad].tolist()}, counted from 0):"
                " are its nodes in order? Remesh there, or mesh with tetrahedra"
            )
        tets = np.concatenate([tets, fans.reshape(-1, 4)])
        owners = np.concatenate([owners, warped.repeat(fans.shape[1])])
    keep = ~repeated_nodes(tets)  # of cells that are collapsed on purpose
    notes = _notes(shape, len(cells), int(keep.sum()), len(warped), 0 if shape == "wedge" else turned)
    return Pieces(tets[keep], owners[keep], points, notes)


def _from_first_corner(shape: str, cells: Ints, rank: Ints) -> Ints:
    """Pieces (m, p, 4): every face without the cell's first corner, joined to that corner."""
    first = rank[cells].argmin(axis=1)
    made: list[tuple[Ints, Ints]] = []
    for corner in range(CORNERS[shape][0]):
        chosen = np.flatnonzero(first == corner)
        faces = [face for face in FACES[shape] if corner not in face]
        triangles = np.concatenate([cut_faces(cells[chosen][:, face], rank) for face in faces], axis=1)
        apex = np.broadcast_to(cells[chosen, corner][:, None, None], (*triangles.shape[:2], 1))
        made.append((chosen, np.concatenate([apex, triangles], axis=2)))
    pieces = np.empty((len(cells), made[0][1].shape[1], 4), dtype=np.int64)
    for chosen, rows in made:
        pieces[chosen] = rows
    return pieces


def _around_centres(shape: str, cells: Ints, points: Floats, rank: Ints) -> tuple[Ints, Floats]:
    """Pieces (m, p, 4) around a new node in the middle of each cell, and the points with those nodes."""
    triangles = np.concatenate([cut_faces(cells[:, face], rank) for face in FACES[shape]], axis=1)
    centres = np.arange(len(cells)) + len(points)
    apex = np.broadcast_to(centres[:, None, None], (*triangles.shape[:2], 1))
    return np.concatenate([apex, triangles], axis=2), np.concatenate([points, points[cells].mean(axis=1)])


def _turned(pieces: Ints, points: Floats, small: Floats) -> tuple[Ints, Mask, int]:
    """Pieces of cells that are inside out turned; which cells (m,) are so in part only; how many were turned."""
    volumes = signed_volumes(points, pieces.reshape(-1, 4)).reshape(pieces.shape[:2])
    negative = volumes.sum(axis=1) < 0
    pieces = np.where(negative[:, None, None], pieces[:, :, [0, 1, 3, 2]], pieces)
    mixed: Mask = np.any(np.where(negative[:, None], -volumes, volumes) < -small, axis=1)
    return pieces, mixed, int(negative.sum())


def _notes(shape: str, count: int, made: int, warped: int, turned: int) -> tuple[str, ...]:
    name = shape if count == 1 else PLURALS[shape]
    notes = [f"{count} {name} {'was' if count == 1 else 'were'} cut into {made} tetrahedra"]
    if warped:
        notes[0] += f" ({warped} of them, warped, around a new node in the middle)"
    if turned:
        notes.append(f"{turned} {shape if turned == 1 else PLURALS[shape]} inside out turned")
    return tuple(notes)
