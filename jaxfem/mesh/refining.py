"""Each tetrahedron in eight: four at its corners, four in the octahedron between (Bey 1995).

Of the octahedron's three diagonals the shortest is taken, which keeps shapes from getting worse (Zhang 1995).
"""

import dataclasses

import numpy as np

from .named import Groups
from .tet import TetMesh
from .topology import unique_edges

EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
CORNERS = ((0, 4, 5, 6), (4, 1, 7, 8), (5, 7, 2, 9), (6, 8, 9, 3))
"""Of the nodes 0 to 3 and the middles 4 to 9 of `EDGES`."""
DIAGONALS = ((4, 9), (5, 8), (6, 7))
RINGS = ((5, 7, 8, 6), (4, 7, 9, 6), (4, 8, 9, 5))
"""The four other middles, in turn around each diagonal."""


def refined(mesh: TetMesh) -> TetMesh:
    """The mesh with edges halved: eight times the elements, those of element k numbered from 8 k on; old nodes keep
    their numbers, all groups come along. A node group gets the middle of each edge between two of its nodes. Curved
    surfaces stay the facets that they were."""
    cells, points, count = mesh.cells, mesh.points, len(mesh.points)
    edges = np.asarray(unique_edges(cells))
    edges = np.sort(edges, axis=1)
    keys = edges[:, 0].astype(np.int64) * count + edges[:, 1]
    order = np.argsort(keys)

    def middle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        wanted = np.minimum(a, b).astype(np.int64) * count + np.maximum(a, b)
        return np.asarray(count + order[np.searchsorted(keys[order], wanted)])

    nodes = np.column_stack([cells, *(middle(cells[:, i], cells[:, j]) for i, j in EDGES)])
    places = np.concatenate([points, points[edges].mean(axis=1)])
    inner = _octahedra(nodes, places)
    children = np.concatenate([nodes[:, np.array(CORNERS)], inner], axis=1).reshape(-1, 4)
    a, b, c, d = (places[children[:, k]] for k in range(4))
    inside_out = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    children[inside_out] = children[inside_out][:, [0, 1, 3, 2]]

    def split(faces: np.ndarray) -> np.ndarray:
        i, j, k = faces.T
        ij, jk, ki = middle(i, j), middle(j, k), middle(k, i)
        parts = ((i, ij, ki), (ij, j, jk), (ki, jk, k), (ij, jk, ki))
        return np.concatenate([np.column_stack(part) for part in parts])

    within: Groups = {}
    for name, group in mesh.node_groups.items():
        mask = np.zeros(count, bool)
        mask[group] = True
        within = {**within, name: np.concatenate([group, count + np.flatnonzero(mask[edges].all(axis=1))])}
    return dataclasses.replace(
        mesh,
        points=places,
        cells=children,
        face_groups={name: split(faces) for name, faces in mesh.face_groups.items()},
        node_groups=within,
        cell_groups={
            name: (8 * np.asarray(group)[:, None] + np.arange(8)).ravel() for name, group in mesh.cell_groups.items()
        },
    )


def _octahedra(nodes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Four elements (m, 4, 4) around the shortest diagonal of each octahedron, nodes (m, 10)."""
    lengths = [np.linalg.norm(places[nodes[:, a]] - places[nodes[:, b]], axis=1) for a, b in DIAGONALS]
    shortest = np.argmin(np.round(np.array(lengths), 12), axis=0)
    found = np.zeros((len(nodes), 4, 4), nodes.dtype)
    for k, ((a, b), ring) in enumerate(zip(DIAGONALS, RINGS, strict=True)):
        own = shortest == k
        parts = [(a, b, ring[i], ring[(i + 1) % 4]) for i in range(4)]
        found[own] = nodes[own][:, np.array(parts)]
    return found
