"""Points located in a mesh, checked against brute force over all elements and all surface triangles."""

import numpy as np
import pytest
from scipy.optimize import nnls

from jaxfem.mesh import MeshError, ball, box, embedding, locate, read


def places(mesh, elements, weights):
    return np.einsum("qi,qij->qj", weights, mesh.points[mesh.cells[elements]])


def test_inside_a_box_every_point_is_reproduced():
    mesh = box((2.0, 1.0, 1.0), (5, 3, 4))
    queries = np.random.default_rng(0).uniform(0, 1, (2000, 3)) * (2.0, 1.0, 1.0)
    elements, weights, outside = locate(mesh.points, mesh.cells, queries)
    assert (outside == 0).all() and (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(places(mesh, elements, weights), queries, atol=1e-14)


def test_outside_a_box_the_nearest_point_is_the_clipped_one():
    mesh = box((2.0, 1.0, 1.0), (5, 3, 4))
    queries = np.random.default_rng(1).uniform(-2, 4, (2000, 3))
    nearest = np.clip(queries, 0.0, (2.0, 1.0, 1.0))
    elements, weights, outside = locate(mesh.points, mesh.cells, queries)
    np.testing.assert_allclose(places(mesh, elements, weights), nearest, atol=1e-13)
    np.testing.assert_allclose(outside, np.linalg.norm(queries - nearest, axis=1), atol=1e-13)
    assert (weights >= 0).all()


def test_nodes_and_faces_count_as_inside():
    mesh = ball(1.0, 2)
    elements, weights, outside = locate(mesh.points, mesh.cells, mesh.points)
    assert (outside == 0).all()
    np.testing.assert_allclose(places(mesh, elements, weights), mesh.points, atol=1e-9)


def brute_force(mesh, query):
    """Distance from a point to the nearest element, each a small least-squares problem over its weights."""
    best = np.inf
    for corners in mesh.points[mesh.cells]:
        system = np.vstack([(corners - query).T, np.full(4, 1e3)])  # the last row holds the sum of the weights at one
        weights = nnls(system, np.array([0.0, 0, 0, 1e3]))[0]
        best = min(best, np.linalg.norm((weights / weights.sum()) @ corners - query))
    return best


def test_against_brute_force_on_a_body_that_is_not_convex(data):
    mesh = read(data / "meshes" / "armadillo_4k.node")
    low, high = mesh.bounds
    queries = np.random.default_rng(2).uniform(low, high, (12, 3))
    elements, weights, outside = locate(mesh.points, mesh.cells, queries)
    assert 0 < (outside > 0).sum() < 12
    expected = [brute_force(mesh, query) for query in queries]
    np.testing.assert_allclose(outside, expected, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(places(mesh, elements, weights) - queries, axis=1), outside, atol=1e-9)


def test_elements_of_very_different_size():
    points = np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 100], [-0.1, -0.1, -0.1]])
    cells = np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 1, 3, 4]])
    queries = np.array([[1.0, 1, 1], [20, 20, 20], [0.01, 0.01, 0.005]])
    elements, _, outside = locate(points, cells, queries)
    assert elements.tolist() == [0, 0, 0] and (outside == 0).all()


def test_orientation_of_the_elements_does_not_matter():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    _, weights, _ = locate(points, [[0, 1, 3, 2]], [[0.1, 0.2, 0.3]])
    np.testing.assert_allclose(weights, [[0.4, 0.1, 0.3, 0.2]])


def test_empty_and_bad_queries():
    mesh = box((1.0, 1.0, 1.0), 1)
    elements, weights, outside = locate(mesh.points, mesh.cells, np.zeros((0, 3)))
    assert elements.shape == (0,) and weights.shape == (0, 4) and outside.shape == (0,)
    with pytest.raises(MeshError, match='node 0 of "query points" is at'):
        locate(mesh.points, mesh.cells, [[np.nan, 0, 0]])
    with pytest.raises(MeshError, match="element 0 has no volume"):
        locate(mesh.points * (1, 1, 0), mesh.cells, [[0, 0, 0]])


def test_a_few_points_are_tried_against_all_elements_with_the_same_outcome(monkeypatch):
    mesh = ball(1.0, 3)
    queries = np.random.default_rng(3).uniform(-1, 1, (40, 3))
    few = locate(mesh.points, mesh.cells, queries)
    assert len(queries) * len(mesh.cells) <= embedding.FEW and 0 < (few[2] > 0).sum() < 40
    monkeypatch.setattr(embedding, "FEW", 0)
    for one, other in zip(few, locate(mesh.points, mesh.cells, queries), strict=True):
        np.testing.assert_array_equal(one, other)
