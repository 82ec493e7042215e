"""Where points lie in a mesh: the element and the weights of its four nodes, inside or at the nearest surface point."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from . import checks
from .checks import Floats, Ints, MeshError
from .topology import boundary_faces

if TYPE_CHECKING:  # slow to import: each function that needs it does so itself
    from scipy.spatial import cKDTree

NEAR = 8  # elements tried first, by their centroids
FEW = 100_000  # pairs of a place and an element that are tried one and all: a tree would gain nothing
PAIRS = 2_000_000  # candidate pairs held at a time


def locate(mesh_points: Any, cells: Any, queries: Any, tolerance: float = 1e-9) -> tuple[Ints, Floats, Floats]:
    """Element (q,), weights (q, 4) of its nodes and distance outside (q,) for each query point (q, 3), m.

    Weights are not negative and sum to one. A point counts as inside when no weight is below -tolerance; its distance
    is 0. A point outside gets the element under the nearest point of the surface, the weights of that point, and the
    distance to it in m. mesh_points (n, 3) and cells (m, 4), e.g. of the mesh at rest. MeshError for queries that are
    not finite or not (q, 3).
    """
    points = checks.as_points(mesh_points, "mesh")
    tets = checks.as_cells(cells, len(points), "mesh")
    flat = np.flatnonzero(checks.degenerate(points, tets))
    if len(flat):
        raise MeshError(f"element {flat[0]} has no volume, so no point has weights in it: locate in the mesh at rest")
    if np.shape(queries) == (0,) or np.shape(queries) == (0, 3):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4)), np.zeros(0)
    places = checks.as_points(queries, "query points")
    elements, weights = _containing(points, tets, places, tolerance)
    outside = np.flatnonzero(elements < 0)
    distance = np.zeros(len(places))
    if len(outside):
        elements[outside], weights[outside], distance[outside] = _on_surface(points, tets, places[outside])
    weights = np.maximum(weights, 0.0)
    return elements, weights / weights.sum(axis=1, keepdims=True), distance


def _containing(points: Floats, tets: Ints, places: Floats, tolerance: float) -> tuple[Ints, Floats]:
    """The element that contains each place and its weights, or -1: nearest centroids first, then all within reach."""
    corners = points[tets]
    inverse = np.asarray(np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)), dtype=np.float64)
    elements, weights = np.full(len(places), -1, dtype=np.int64), np.zeros((len(places), 4))

    def fill(query: Ints, element: Ints) -> None:
        found = _weights(corners[element, 0], inverse[element], places[query])
        best = _first_best(query, found.min(axis=1))
        best = best[found[best].min(axis=1) >= -tolerance]
        elements[query[best]], weights[query[best]] = element[best], found[best]

    if len(places) * len(tets) <= FEW:
        fill(np.repeat(np.arange(len(places)), len(tets)), np.tile(np.arange(len(tets)), len(places)))
        return elements, weights
    from scipy.spatial import cKDTree

    centroids = corners.mean(axis=1)
    reach = float(np.linalg.norm(corners - centroids[:, None], axis=-1).max())
    tree = cKDTree(centroids)
    count = min(NEAR, len(tets))
    near = tree.query(places, k=count)[1].reshape(-1, count)
    fill(np.repeat(np.arange(len(places)), count), near.ravel())
    slack = 4.0 * tolerance * reach  # an element grows by that much when its weights may be -tolerance
    low, high = points.min(axis=0) - slack, points.max(axis=0) + slack
    open_ = np.flatnonzero((elements < 0) & ((places >= low) & (places <= high)).all(axis=1))
    for query, element in _pairs(tree, places[open_], np.full(len(open_), reach * (1.0 + 1e-9) + slack)):
        fill(open_[query], element)
    return elements, weights


def _weights(origin: Floats, inverse: Floats, places: Floats) -> Floats:
    """Barycentric weights (p, 4) from the first corner (p, 3) and the inverse of the three edges from it (p, 3, 3)."""
    rest = np.einsum("pij,pj->pi", inverse, places - origin)
    return np.column_stack([1.0 - rest.sum(axis=1), rest])


def _first_best(query: Ints, score: Floats) -> Ints:
    """For each distinct query the position of its highest score."""
    order = np.lexsort((np.arange(len(query)), -score, query))
    return order[np.unique(query[order], return_index=True)[1]]


def _pairs(tree: "cKDTree", places: Floats, radii: Floats) -> Iterator[tuple[Ints, Ints]]:
    """All (place, tree point) pairs within each place's radius, a limited number at a time."""
    if not len(places):
        return
    counts = tree.query_ball_point(places, radii, return_length=True)
    batch = np.cumsum(counts) // PAIRS
    for number in np.unique(batch):
        chosen = np.flatnonzero(batch == number)
        lists = tree.query_ball_point(places[chosen], radii[chosen])
        hits = np.concatenate([np.asarray(each, dtype=np.int64) for each in lists])
        yield np.repeat(chosen, [len(each) for each in lists]), hits


def _on_surface(points: Floats, tets: Ints, places: Floats) -> tuple[Ints, Floats, Floats]:
    """The element under the nearest surface point of each place, that point's weights, and the distance to it."""
    from scipy.spatial import cKDTree

    triangles, owners = boundary_faces(tets)
    if not len(triangles):
        raise MeshError("the elements have no outer surface: are all of them there twice?")
    corners = points[triangles]
    centroids = corners.mean(axis=1)
    reach = float(np.linalg.norm(corners - centroids[:, None], axis=-1).max())
    tree = cKDTree(centroids)
    best = tree.query(places)[1]
    shares, distance = _closest_on_triangle(corners[best], places)
    # a nearer triangle has its centroid within (distance so far) + (largest triangle's radius)
    for query, triangle in _pairs(tree, places, (distance + reach) * (1.0 + 1e-9)):
        found, away = _closest_on_triangle(corners[triangle], places[query])
        first = _first_best(query, -away)
        first = first[away[first] < distance[query[first]]]
        best[query[first]], shares[query[first]], distance[query[first]] = triangle[first], found[first], away[first]
    same = tets[owners[best]][:, :, None] == triangles[best][:, None, :]
    weights = np.einsum("qij,qj->qi", same.astype(np.float64), shares)
    return owners[best], weights, distance


def _closest_on_triangle(corners: Floats, places: Floats) -> tuple[Floats, Floats]:
    """Weights (p, 3) of the point of each triangle (p, 3, 3) nearest to each place (p, 3), and its distance (p,)."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    uu, uv, vv = (np.einsum("pi,pi->p", x, y) for x, y in ((u, u), (u, v), (v, v)))
    du, dv = (np.einsum("pi,pi->p", x, places - a) for x in (u, v))
    area = np.maximum(uu * vv - uv * uv, np.finfo(float).tiny)
    s, t = (vv * du - uv * dv) / area, (uu * dv - uv * du) / area
    choices = [np.column_stack([1.0 - s - t, s, t])]
    for i, j in ((0, 1), (1, 2), (2, 0)):  # the nearest point of each edge
        edge = corners[:, j] - corners[:, i]
        along = np.einsum("pi,pi->p", places - corners[:, i], edge) / np.einsum("pi,pi->p", edge, edge)
        share = np.zeros_like(choices[0])
        share[:, j] = np.clip(along, 0.0, 1.0)
        share[:, i] = 1.0 - share[:, j]
        choices.append(share)
    weights = np.stack(choices)
    away = np.linalg.norm(np.einsum("cpi,pij->cpj", weights, corners) - places, axis=-1)
    inside = choices[0].min(axis=1) >= 0.0
    away[0, ~inside] = np.inf
    pick = away.argmin(axis=0)
    rows = np.arange(len(places))
    return weights[pick, rows], away[pick, rows]
