"""Along which diagonal each quadrilateral face is cut: one answer for both cells that have it.

Where the triangles of a neighbour (tetrahedra on a brick, without pyramids between) lie on a face already, theirs.
Elsewhere from the corner that is first in one order of all nodes, which lets a whole cell be cut without new nodes.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from .checks import Ints, Mask, first_equal

FACES: dict[str, tuple[tuple[int, ...], ...]] = {  # outward, in the node order of Abaqus and Gmsh
    "tetra": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
RINGS = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]])


@dataclasses.dataclass(frozen=True)
class Diagonals:
    """`rank` (n,) of each node, and the faces (k, 4) that neighbours cut, with an end (k,) of the diagonal."""

    rank: Ints
    given: Ints
    ends: Ints

    def by_order(self, faces: Ints) -> Mask:
        """Whether faces (k, 4) are cut from their first to their third corner, by the order of nodes alone."""
        even: Mask = self.rank[faces].argmin(axis=1) % 2 == 0
        return even

    def even(self, faces: Ints) -> Mask:
        """Whether they are, all told."""
        even = self.by_order(faces)
        if len(self.given):
            first = first_equal(np.concatenate([self.given, faces]))[len(self.given) :]
            found = np.flatnonzero(first < len(self.given))
            end = self.ends[first[found]][:, None]
            even[found] = (faces[found][:, [0, 2]] == end).any(axis=1)
        return even

    def triangles(self, faces: Ints, even: Mask | None = None) -> Ints:
        """Triangles (k, 1 or 2, 3) of faces (k, 3) or (k, 4); `even` as of the method, which is taken without it."""
        if faces.shape[1] == 3:
            return faces[:, None]
        chosen = (self.even(faces) if even is None else even)[:, None, None]
        return np.where(chosen, faces[:, [[0, 1, 2], [0, 2, 3]]], faces[:, [[1, 2, 3], [1, 3, 0]]])


def diagonals(count: int, solids: Mapping[str, Ints]) -> Diagonals:
    """The rule for `count` nodes and the corners (m, c) of cells by their shape.

    First in order are the ends of diagonals that neighbours give. Then, where nodes of hexahedra can be coloured like a
    chessboard, those of one colour: diagonals alternate, and a body of bricks does not lean to one side. Then the
    file's order holds.
    """
    given, ends = _given(solids)
    early = np.zeros(count, dtype=np.int64)
    early[ends.reshape(-1)] -= 1
    early[np.setdiff1d(given.reshape(-1), ends.reshape(-1))] += 1
    colour = _chessboard(count, solids["hexahedron"]) if "hexahedron" in solids else np.zeros(count, dtype=np.int64)
    rank = np.empty(count, dtype=np.int64)
    rank[np.lexsort((np.arange(count), colour, early))] = np.arange(count)
    return Diagonals(rank, given, ends[:, 0])


def _given(solids: Mapping[str, Ints]) -> tuple[Ints, Ints]:
    """Faces (k, 4) on which triangles of other cells lie, and both ends (k, 2) of the diagonal between these."""
    sides = [cells[:, face] for shape, cells in solids.items() for face in FACES[shape]]
    quads = np.concatenate([np.zeros((0, 4), np.int64), *(side for side in sides if side.shape[1] == 4)])
    triangles = np.concatenate([np.zeros((0, 3), np.int64), *(side for side in sides if side.shape[1] == 3)])
    if not len(quads) or not len(triangles):
        return np.zeros((0, 4), np.int64), np.zeros((0, 2), np.int64)
    halves = np.concatenate([np.delete(quads, corner, axis=1) for corner in range(4)])  # without one corner each
    found = first_equal(np.concatenate([triangles, halves]))[len(triangles) :] < len(triangles)
    missing = found.reshape(4, len(quads))
    odd, even = missing[0] | missing[2], missing[1] | missing[3]
    chosen = odd | even
    ends = np.where(even[:, None], quads[:, [0, 2]], quads[:, [1, 3]])
    return quads[chosen], ends[chosen]


def _chessboard(count: int, hexahedra: Ints) -> Ints:
    """A colour 0 or 1 (n,) for each node, different along all edges of hexahedra where that can be; else 0."""
    from scipy.sparse import coo_matrix  # slow to import: only where there are hexahedra
    from scipy.sparse.csgraph import connected_components

    a, b = hexahedra[:, RINGS].reshape(-1, 2).T
    # The double cover: each edge leads to the other side, so that rings of odd length alone join a node's two sides.
    rows, columns = np.concatenate([a, b]), np.concatenate([b, a]) + count
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    colour: Ints = (label[:count] > label[count:]).astype(np.int64)
    return colour
