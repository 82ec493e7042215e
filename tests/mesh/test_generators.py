"""Boxes, beams and balls: volumes, matching faces, the order of nodes and elements, convergence of the ball."""

import numpy as np
import pytest

from jaxfem.mesh import MeshError, ball, beam, box, quality
from jaxfem.mesh.topology import element_faces


@pytest.mark.parametrize(("tets_per_cell", "mirrored"), [(5, True), (6, True), (6, False), (12, True), (12, False)])
@pytest.mark.parametrize("cells", [(1, 1, 1), (4, 3, 2), (2, 5, 3)])
def test_box_fills_its_volume_and_faces_match(tets_per_cell, mirrored, cells):
    mesh = box((4.0, 1.5, 0.5), cells, tets_per_cell, origin=(-1.0, 2.0, 0.5), mirrored=mirrored)
    nx, ny, nz = cells
    assert len(mesh.cells) == nx * ny * nz * tets_per_cell and mesh.notes == ()
    assert (mesh.volumes > 0).all() and mesh.volume == pytest.approx(3.0, rel=1e-13)
    np.testing.assert_allclose(mesh.bounds, [[-1.0, 2.0, 0.5], [3.0, 3.5, 1.0]])
    faces, counts = np.unique(np.sort(element_faces(mesh.cells), axis=1), axis=0, return_counts=True)
    outside = 4 * (nx * ny + ny * nz + nz * nx)
    assert counts.max() <= 2 and (counts == 1).sum() == outside == len(mesh.surface)
    assert 2 * len(faces) == 4 * len(mesh.cells) + outside
    assert {name: len(group) for name, group in mesh.face_groups.items()} == {
        "x-": 2 * ny * nz,
        "x+": 2 * ny * nz,
        "y-": 2 * nx * nz,
        "y+": 2 * nx * nz,
        "z-": 2 * nx * ny,
        "z+": 2 * nx * ny,
    }
    assert (mesh.points[mesh.nodes("y+"), 1] == 3.5).all()


@pytest.mark.parametrize("tets_per_cell", [5, 12])
def test_mirrored_cells_make_a_mirrored_mesh(tets_per_cell):
    mesh = box((2.0, 2.0, 2.0), 2, tets_per_cell)
    tets = {frozenset(map(tuple, corners)) for corners in mesh.points[mesh.cells]}
    for axis in range(3):
        flipped = mesh.points.copy()
        flipped[:, axis] = 2.0 - flipped[:, axis]
        assert {frozenset(map(tuple, corners)) for corners in flipped[mesh.cells]} == tets


def test_six_tetrahedra_follow_the_reference_convention(reference):
    case = np.load(reference / "static_linear_8x2x2.npz")
    mesh = box((4.0, 1.0, 1.0), (8, 2, 2))
    np.testing.assert_array_equal(mesh.cells, case["tets"])
    np.testing.assert_allclose(mesh.points, case["nodes"], atol=1e-15)


def test_beam_has_nearly_cubic_cells():
    mesh = beam(0.10, 0.03, 0.021, cells_along=20)
    assert len(mesh.points) == 21 * 7 * 5 and mesh.volume == pytest.approx(0.10 * 0.03 * 0.021)
    assert len(beam(1.0, 0.001, 0.001, 4).points) == 5 * 2 * 2


def test_ball_converges_with_order_two_and_is_well_shaped():
    missing = [4 / 3 * np.pi * 0.5**3 - ball(0.5, n).volume for n in (2, 4, 8)]
    orders = np.log2(np.divide(missing[:-1], missing[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.12)
    mesh = ball(0.5, 4, center=(1.0, 2.0, 3.0))
    assert len(mesh.cells) == 20 * 4**3 and len(mesh.faces("surface")) == 20 * 4**2
    radii = np.linalg.norm(mesh.points[mesh.surface_nodes] - (1.0, 2.0, 3.0), axis=1)
    np.testing.assert_allclose(radii, 0.5)
    report = quality(mesh)
    assert report.min_dihedral > 35.0 and report.max_dihedral < 135.0 and report.warnings() == ()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: box((1, 1, 0), 2), r"a box of size \(1, 1, 0\): give three positive lengths"),
        (lambda: box((1, 1), 2), "give three positive lengths"),
        (lambda: box((1, 1, 1), (2, 0, 2)), r"cells=\(2, 0, 2\): give positive whole numbers"),
        (lambda: box((1, 1, 1), 2.5), "cells=2.5: give positive whole numbers"),
        (lambda: box((1, 1, 1), 2, tets_per_cell=7), "tets_per_cell=7: .* 5, 6 or 12"),
        (lambda: box((1, 1, 1), 2, tets_per_cell=5, mirrored=False), "neighbours would not match"),
        (lambda: box((1, 1, 1), 2, origin=(0, 0)), "give three numbers in m"),
        (lambda: beam(-1.0, 1, 1, 3), "both must be positive"),
        (lambda: ball(0.0, 3), "a ball of radius 0.0: give a positive length"),
        (lambda: ball(1.0, 0), "cells=0: give positive whole numbers"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(MeshError, match=message):
        make()
