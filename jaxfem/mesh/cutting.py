"""Hexahedra, wedges and pyramids cut into tetrahedra that fit together.

Each cell is cut from its first corner in one order of all nodes: every face of it without that corner is cut from its
own first corner, and each triangle joined to the first (Dompierre, Labbe, Vallet, Camarero, 1999: "How to subdivide
pyramids, prisms and hexahedra into tetrahedra"). A face is cut alike from both sides, as its nodes are in one order.
Where a warped cell would get a piece turned inside out, or a neighbour has cut a face otherwise, the cell's centre
becomes a node instead, joined to all faces.
"""

import dataclasses

import numpy as np

from .checks import FLAT, Floats, Ints, Mask, MeshError, repeated_nodes, signed_volumes
from .diagonals import FACES, Diagonals
from .raw import CORNERS

PLURALS = {"hexahedron": "hexahedra", "wedge": "wedges", "pyramid": "pyramids"}


@dataclasses.dataclass
class Pieces:
    """Tetrahedra (t, 4), the cell (t,) of which each is a piece, the points with any new ones, and what to say."""

    tets: Ints
    parents: Ints
    points: Floats
    notes: tuple[str, ...] = ()


def cut_solids(shape: str, cells: Ints, points: Floats, rule: Diagonals, source: str) -> Pieces:
    """The tetrahedra of cells (m, corners) of one shape; volumes are kept, and each piece has its cell's orientation.

    MeshError for a cell so twisted that it has no inside.
    """
    if shape == "tetra":
        return Pieces(cells, np.arange(len(cells)), points)
    pieces = _from_first_corner(shape, cells, rule)
    small = FLAT * np.ptp(points[cells], axis=1).max(axis=1)[:, None] ** 3
    pieces, mixed, turned = _turned(pieces, points, small)
    split = mixed | _cut_otherwise(shape, cells, rule)
    parents = np.arange(len(cells))[:, None].repeat(pieces.shape[1], 1)
    tets, owners = pieces[~split].reshape(-1, 4), parents[~split].reshape(-1)
    centred = np.flatnonzero(split)
    if len(centred):
        fans, points = _around_centres(shape, cells[centred], points, rule)
        fans, twisted, _ = _turned(fans, points, small[centred])
        if twisted.any():
            bad = int(centred[np.flatnonzero(twisted)[0]])
            raise MeshError(
                f"{shape} {bad} of {source} is turned inside out in part (nodes {cells[bad].tolist()}, counted from 0):"
                " are its nodes in order? Remesh there, or mesh with tetrahedra"
            )
        tets = np.concatenate([tets, fans.reshape(-1, 4)])
        owners = np.concatenate([owners, centred.repeat(fans.shape[1])])
    keep = ~repeated_nodes(tets)  # of cells that are collapsed on purpose
    notes = _notes(shape, len(cells), int(keep.sum()), len(centred), 0 if shape == "wedge" else turned)
    return Pieces(tets[keep], owners[keep], points, notes)


def _from_first_corner(shape: str, cells: Ints, rule: Diagonals) -> Ints:
    """Pieces (m, p, 4): every face without the cell's first corner, joined to that corner."""
    first = rule.rank[cells].argmin(axis=1)
    made: list[tuple[Ints, Ints]] = []
    for corner in range(CORNERS[shape][0]):
        chosen = np.flatnonzero(first == corner)
        faces = [cells[chosen][:, face] for face in FACES[shape] if corner not in face]
        triangles = np.concatenate([rule.triangles(face, rule.by_order(face)) for face in faces], axis=1)
        apex = np.broadcast_to(cells[chosen, corner][:, None, None], (*triangles.shape[:2], 1))
        made.append((chosen, np.concatenate([apex, triangles], axis=2)))
    pieces = np.empty((len(cells), made[0][1].shape[1], 4), dtype=np.int64)
    for chosen, rows in made:
        pieces[chosen] = rows
    return pieces


def _cut_otherwise(shape: str, cells: Ints, rule: Diagonals) -> Mask:
    """Which cells (m,) have a face that a neighbour cuts along the other diagonal than the order of nodes says."""
    other = np.zeros(len(cells), dtype=bool)
    if len(rule.given):
        for face in (cells[:, face] for face in FACES[shape] if len(face) == 4):
            other |= rule.even(face) != rule.by_order(face)
    return other


def _around_centres(shape: str, cells: Ints, points: Floats, rule: Diagonals) -> tuple[Ints, Floats]:
    """Pieces (m, p, 4) around a new node in the middle of each cell, and the points with those nodes."""
    triangles = np.concatenate([rule.triangles(cells[:, face]) for face in FACES[shape]], axis=1)
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


def _notes(shape: str, count: int, made: int, centred: int, turned: int) -> tuple[str, ...]:
    name = shape if count == 1 else PLURALS[shape]
    notes = [f"{count} {name} {'was' if count == 1 else 'were'} cut into {made} tetrahedra"]
    if centred:
        notes[0] += f" ({centred} of them, warped or beside cut faces, around a new node in the middle)"
    if turned:
        notes.append(f"{turned} {shape if turned == 1 else PLURALS[shape]} inside out turned")
    return tuple(notes)
