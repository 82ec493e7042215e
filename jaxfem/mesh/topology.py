"""Faces, edges and the outer surface of a list of tetrahedra, by node numbers alone."""

import numpy as np

from .checks import EDGES, Floats, Ints, first_equal

FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # face i is opposite node i, its normal points outward


def element_faces(cells: Ints) -> Ints:
    """The four outward triangles of every positively oriented element (4 m, 3), element by element."""
    return cells[:, FACES].reshape(-1, 3)


def face_counts(faces: Ints) -> tuple[Ints, Ints]:
    """For each face the first face with the same nodes, and how many faces share them: both (k,)."""
    first = first_equal(faces)
    return first, np.bincount(first, minlength=len(faces))[first]


def boundary_faces(cells: Ints) -> tuple[Ints, Ints]:
    """Outward triangles (k, 3) that belong to one element only, and that element (k,)."""
    faces = element_faces(cells)
    alone = np.flatnonzero(face_counts(faces)[1] == 1)
    return faces[alone], alone // 4


def unique_edges(cells: Ints) -> Ints:
    """Every edge of the tetrahedra (m, 4) once, as sorted node pairs (e, 2)."""
    return np.unique(np.sort(cells[:, EDGES].reshape(-1, 2), axis=1), axis=0)


def triangle_edge_counts(triangles: Ints) -> Ints:
    """How many triangles meet at each edge of a surface (e,): two everywhere on a closed, simple one."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def components(cells: Ints, nodes: int) -> int:
    """Number of parts that hang together through shared nodes (unused nodes count as a part each)."""
    return len(np.unique(first_of_each(nodes, cells[:, [[0, 1], [0, 2], [0, 3]]].reshape(-1, 2))))


def first_of_each(count: int, pairs: Ints) -> Ints:
    """For each of `count` nodes (n,) the least of those that pairs (k, 2) tie it to, directly or in a chain."""
    least = np.arange(count)
    while True:
        lower = least[pairs].min(axis=1)
        new = least.copy()
        np.minimum.at(new, pairs.ravel(), lower.repeat(2))
        new = new[new]
        if (new == least).all():
            return least
        least = new


def oriented_like(faces: Ints, element_faces: Ints) -> tuple[Ints, Ints]:
    """The given faces with the outward order of the element that has them, and the numbers of those no element has.

    A face between two elements is oriented as the first of the two sees it.
    """
    first = first_equal(np.concatenate([element_faces, faces]))[len(element_faces) :]
    found = first < len(element_faces)
    matched = faces.copy()
    matched[found] = element_faces[first[found]]
    return matched, np.flatnonzero(~found)


def dihedral_angles(points: Floats, cells: Ints) -> Floats:
    """The six angles (m, 6) between the faces of each element, in degrees."""
    corners = points[element_faces(cells)].reshape(len(cells), 4, 3, 3)
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    first, second = np.triu_indices(4, 1)
    cosines = -np.einsum("mpi,mpi->mp", normals[:, first], normals[:, second])  # both normals point outward
    angles: Floats = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    return angles
