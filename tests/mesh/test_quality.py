"""The quality report against shapes whose figures are known."""

import numpy as np
import pytest

from jaxfem.mesh import TetMesh, ball, box, quality

REGULAR = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


def test_regular_tetrahedron():
    report = quality(TetMesh(REGULAR, [[0, 1, 2, 3]]))
    assert report.min_dihedral == pytest.approx(np.degrees(np.arccos(1 / 3))) == pytest.approx(report.max_dihedral)
    assert report.min_shape == pytest.approx(1.0) and report.volume == pytest.approx(8 / 3)
    assert report.min_edge == pytest.approx(8**0.5) and report.surface_area == pytest.approx(8 * 3**0.5)
    assert report.closed_surface and report.components == 1 and report.warnings() == ()


def test_box_report_text():
    mesh = box((4.0, 1.0, 1.0), (4, 1, 1), name="beam")
    report = quality(mesh)
    assert report.min_dihedral == pytest.approx(45.0) and report.max_dihedral == pytest.approx(90.0)
    assert report.surface_area == pytest.approx(18.0) and report.surface_triangles == 36
    text = report.text()
    for part in ('mesh "beam"', "20", "24", "4 x 1 x 1 m", "45.0 to 90.0 degrees", "x- (2)"):
        assert part in text
    assert "warning" not in text


def test_two_parts_that_touch_without_sharing_nodes():
    mesh = box((1.0, 1.0, 1.0), 1)
    points = np.concatenate([mesh.points, mesh.points + np.array([1.0, 0, 0])])
    report = quality(TetMesh(points, np.concatenate([mesh.cells, mesh.cells + 8])))
    assert report.components == 2 and report.coincident_nodes == 8
    assert "2 separate parts" in report.text() and "8 nodes lie on top of another" in report.text()


def test_flat_overlapping_and_hinged_elements():
    flat = REGULAR.copy()
    flat[:, 2] *= 0.01
    report = quality(TetMesh(flat, [[0, 1, 2, 3]]))
    assert report.min_dihedral < 2.0 and "element 0 is nearly flat" in report.text()
    fan = TetMesh(np.concatenate([REGULAR, [[3.0, 3, -3], [4, 3, -3]]]), [[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]])
    assert quality(fan).shared_too_often == 1 and "elements overlap" in quality(fan).text()
    hinge = np.array([[0.0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    report = quality(TetMesh(hinge, [[0, 1, 2, 3], [0, 1, 4, 5]]))
    assert not report.closed_surface and "by an edge alone" in report.text()


def test_shape_is_the_ratio_of_radii():
    corner = TetMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), [[0, 1, 2, 3]])
    inscribed, circumscribed = 1 / (3 + 3**0.5), 3**0.5 / 2
    assert quality(corner).min_shape == pytest.approx(3 * inscribed / circumscribed)
    assert quality(ball(1.0, 3)).worst[0] == quality(ball(2.0, 3)).worst[0]
