"""Meshes of boxes, beams and balls, with named sides."""

from collections.abc import Sequence
from itertools import permutations, product
from typing import Any

import numpy as np

from .checks import Floats, Ints, MeshError, is_positive
from .tet import TetMesh

CORNERS = list(product((0, 1), repeat=3))  # corner (i, j, k) of a cell has the number 4 i + 2 j + k


def box(
    size: Sequence[float],
    cells: int | Sequence[int],
    tets_per_cell: int = 6,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    name: str = "box",
    mirrored: bool = True,
) -> TetMesh:
    """A box of nx x ny x nz cells, each cut into 5, 6 or 12 tetrahedra; face groups "x-", "x+", ... "z+".

    size (3,) and origin (3,) in m. Node (i, j, k) has the number (i (ny+1) + j) (nz+1) + k. Six tetrahedra: one a
    permutation of the axes in lexicographic order. Twelve: one more node in the middle of each cell, numbered after the
    grid. Five and twelve are mirrored from cell to cell: the sides' diagonals alternate, so a beam that bends does not
    drift aside; mirrored=False cuts all cells alike, which five cannot. MeshError for a size or count that is not
    positive.
    """
    lengths, counts, corner = _box_arguments(size, cells, origin)
    if tets_per_cell not in CUTS:
        raise MeshError(f"tets_per_cell={tets_per_cell!r}: a cell can be cut into 5, 6 or 12 tetrahedra")
    if mirrored not in CUTS[tets_per_cell]:
        raise MeshError("five tetrahedra a cell with mirrored=False: the sides of neighbours would not match")
    points = corner + _grid(counts + 1) / counts * lengths
    corners, centres = _cell_corners(counts)
    if tets_per_cell == 12:
        points = np.concatenate([points, corner + (centres + 0.5) / counts * lengths])
        corners = np.column_stack([corners, np.prod(counts + 1) + np.arange(len(corners))])
    even, odd = CUTS[tets_per_cell][mirrored]
    tets = np.where(centres.sum(axis=1)[:, None, None] % 2 == 1, corners[:, odd], corners[:, even])
    mesh = TetMesh(points, tets.reshape(-1, 4), name)
    return TetMesh(points, mesh.cells, name, face_groups=_sides(mesh, corner, lengths, counts))


def beam(
    length: float,
    width: float,
    height: float,
    cells_along: int,
    tets_per_cell: int = 6,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    name: str = "beam",
) -> TetMesh:
    """A box with its length along x, width along y and height along z (m), of cells as near to cubes as they get.

    cells_along counts the cells along x. Groups and errors as for `box`.
    """
    if not (is_positive(cells_along) and is_positive(length)):
        raise MeshError(f"a beam of length {length!r} with cells_along={cells_along!r}: both must be positive")
    edge = length / cells_along
    across = [max(1, round(each / edge)) for each in (width, height)]
    return box((length, width, height), (cells_along, *across), tets_per_cell, origin, name)


def ball(radius: float, cells: int, center: Sequence[float] = (0.0, 0.0, 0.0), name: str = "ball") -> TetMesh:
    """A ball of 20 cells^3 well-shaped tetrahedra, `cells` counted along a radius; face group "surface".

    radius and center (3,) in m. The volume falls short of the true one by a term of order 1 / cells^2. Each face of an
    icosahedron makes a tetrahedron with the center, cut like the corner x >= y >= z of a box and bent so that each
    layer lies on a sphere. MeshError for a radius or count that is not positive.
    """
    if not is_positive(radius):
        raise MeshError(f"a ball of radius {radius!r}: give a positive length in m")
    layers = int(_counts(cells)[0])
    grid = _grid(np.full(3, layers + 1)).astype(np.int64)
    wedge = _cell_corners(np.full(3, layers))[0][:, _six()].reshape(-1, 4)
    inside = (grid[:, 0] >= grid[:, 1]) & (grid[:, 1] >= grid[:, 2])
    wedge = wedge[inside[wedge].all(axis=1)]
    i, j, k = grid.T
    shares = np.column_stack([i - j, j - k, k])  # how much of each corner of the icosahedron's face
    corners, faces = _icosahedron()
    spokes = np.einsum("nc,fcx->fnx", shares.astype(np.float64), corners[faces])
    length = np.linalg.norm(spokes, axis=-1, keepdims=True)
    points = (spokes / np.where(length > 0, length, 1.0) * (i / layers)[:, None]).reshape(-1, 3)
    cells_all = (np.arange(len(faces))[:, None, None] * len(grid) + wedge).reshape(-1, 4)
    merged = _merge(points, 1e-6 / layers)[cells_all]
    used, tets = np.unique(merged, return_inverse=True)
    middle = np.asarray(center, dtype=np.float64)
    mesh = TetMesh(middle + radius * points[used], tets.reshape(-1, 4), name)
    return TetMesh(mesh.points, mesh.cells, name, face_groups={"surface": mesh.surface})


def _box_arguments(size: Any, cells: Any, origin: Any) -> tuple[Floats, Ints, Floats]:
    lengths = np.asarray(size, dtype=np.float64)
    if lengths.shape != (3,) or not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise MeshError(f"a box of size {size!r}: give three positive lengths in m")
    corner = np.asarray(origin, dtype=np.float64)
    if corner.shape != (3,) or not np.isfinite(corner).all():
        raise MeshError(f"a box at origin {origin!r}: give three numbers in m")
    return lengths, _counts(cells), corner


def _counts(cells: Any) -> Ints:
    counts = np.asarray(cells)
    if counts.shape not in ((), (3,)) or not np.issubdtype(counts.dtype, np.integer) or (counts < 1).any():
        raise MeshError(f"cells={cells!r}: give positive whole numbers")
    return np.broadcast_to(counts, (3,)).astype(np.int64)


def _grid(counts: Ints) -> Floats:
    """All (i, j, k) below counts, the last index fastest."""
    return np.stack(np.meshgrid(*(np.arange(n, dtype=np.float64) for n in counts), indexing="ij"), axis=-1).reshape(
        -1, 3
    )


def _cell_corners(counts: Ints) -> tuple[Ints, Ints]:
    """The eight node numbers of each cell (cells, 8) in the order of CORNERS, and the cell's own (i, j, k)."""
    places = _grid(counts).astype(np.int64)
    nodes = places[:, None, :] + np.array(CORNERS)
    return (nodes[..., 0] * (counts[1] + 1) + nodes[..., 1]) * (counts[2] + 1) + nodes[..., 2], places


def _six() -> Ints:
    """Six paths from corner 0 to corner 7; odd permutations have the last two nodes swapped, for positive volume."""
    tets = []
    for axes in permutations(range(3)):
        steps = np.cumsum([np.zeros(3, dtype=int), *np.eye(3, dtype=int)[list(axes)]], axis=0)
        path = [int(step @ (4, 2, 1)) for step in steps]
        even = np.linalg.det(np.eye(3)[list(axes)]) > 0
        tets.append(path if even else [path[0], path[1], path[3], path[2]])
    return np.array(tets, dtype=np.int64)


def _five() -> Ints:
    """One tetrahedron in the middle and one at each of the four corners with an odd sum."""
    tets = np.array([[0, 6, 5, 3], [4, 6, 5, 0], [2, 6, 0, 3], [1, 5, 3, 0], [7, 5, 6, 3]], dtype=np.int64)
    return _positive(tets, np.array(CORNERS, dtype=np.float64))


def _twelve(mirrored: bool) -> Ints:
    """Two tetrahedra from each side of the cell to its middle (node 8).

    A side's diagonal joins its corners with an even sum; in cells cut alike its lowest and highest corner.
    """
    tets = []
    for axis, level in product(range(3), (0, 1)):
        side = [number for number, corner in enumerate(CORNERS) if corner[axis] == level]
        ends = [n for n in side if sum(CORNERS[n]) % 2 == 0] if mirrored else [side[0], side[3]]
        tets += [[*ends, number, 8] for number in side if number not in ends]
    return _positive(np.array(tets, dtype=np.int64), np.array([*CORNERS, (0.5, 0.5, 0.5)]))


def _mirror(tets: Ints) -> Ints:
    """The same cut with x -> 1 - x; the middle (node 8) stays."""
    return np.where(tets < 8, tets ^ 4, tets)[:, [0, 1, 3, 2]]


def _positive(tets: Ints, corners: Floats) -> Ints:
    a, b, c, d = (corners[tets[:, i]] for i in range(4))
    bad = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    return np.where(bad[:, None], tets[:, [0, 1, 3, 2]], tets)


# Mirrored or not: how a cell with an even sum of its place is cut, and one with an odd sum.
CUTS = {
    5: {True: (_five(), _mirror(_five()))},
    6: {True: (_six(), _six()), False: (_six(), _six())},  # opposite sides are cut alike
    12: {
        True: (_twelve(mirrored=True), _mirror(_twelve(mirrored=True))),
        False: (_twelve(mirrored=False), _twelve(mirrored=False)),
    },
}


def _sides(mesh: TetMesh, corner: Floats, lengths: Floats, counts: Ints) -> dict[str, Ints]:
    """The surface triangles on each of the six planes."""
    places = np.rint((mesh.points - corner) / lengths * counts * 2).astype(np.int64)[mesh.surface]  # in half cells
    planes = ((axis, label, end) for axis in range(3) for label, end in (("-", 0), ("+", 2 * counts[axis])))
    return {"xyz"[axis] + label: mesh.surface[(places[..., axis] == end).all(axis=1)] for axis, label, end in planes}


def _icosahedron() -> tuple[Floats, Ints]:
    """Twelve corners on the unit sphere and the 20 faces (triples at the shortest distance from each other)."""
    golden = (1.0 + 5.0**0.5) / 2.0
    flat = [(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    corners = np.array([np.roll(point, shift) for shift in range(3) for point in flat]) / np.hypot(1.0, golden)
    near = np.linalg.norm(corners[:, None] - corners[None], axis=-1) < 1.1 * 2.0 / np.hypot(1.0, golden)
    triples = [
        (a, b, c) for a in range(12) for b in range(a) for c in range(b) if near[a, b] and near[b, c] and near[a, c]
    ]
    return corners, np.array(triples, dtype=np.int64)


def _merge(points: Floats, spacing: float) -> Ints:
    """For each point the first one at the same place, to within `spacing` (far finer than the mesh)."""
    places = np.rint(points / spacing).astype(np.int64)
    _, first, inverse = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return first[inverse.ravel()]
