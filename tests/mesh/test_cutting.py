"""Hexahedra, wedges and pyramids cut into tetrahedra: volumes kept, neighbours fitting, warped and collapsed cells."""

import numpy as np
import pytest

from jaxfem.mesh import MeshError, from_cells, quality

CUBE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])


def bricks(counts, rng=None, warp=0.0):
    """Points and hexahedra of a unit grid; with `rng` the nodes are in any order, moved aside by `warp` inside."""
    axes = np.meshgrid(*[np.arange(n + 1.0) for n in counts], indexing="ij")
    points = np.stack([a.ravel() for a in axes], axis=1)
    number = np.arange(len(points)).reshape([n + 1 for n in counts])
    i, j, k = np.meshgrid(*[np.arange(n) for n in counts], indexing="ij")
    steps = CUBE.astype(int)
    cells = np.stack([number[i + a, j + b, k + c].ravel() for a, b, c in steps], axis=1)
    if rng is None:
        return points, cells
    inside = ((points > 0) & (points < counts)).all(axis=1)
    points = points + warp * inside[:, None] * rng.uniform(-1, 1, points.shape)
    order = rng.permutation(len(points))
    moved = np.empty_like(points)
    moved[order] = points
    return moved, order[cells]


def test_bricks_in_any_order_fit_together():
    """A face cut differently from its two sides would show as faces inside: the surface would be larger."""
    points, cells = bricks((3, 2, 4), np.random.default_rng(1), warp=0.15)
    mesh = from_cells(points, {"hexahedron": cells})
    report = quality(mesh)
    assert len(mesh.cells) == 6 * 24 and mesh.volume == pytest.approx(24.0, rel=1e-12)
    assert report.surface_area == pytest.approx(2 * (3 * 2 + 2 * 4 + 4 * 3), rel=1e-12)
    assert report.closed_surface and report.components == 1 and report.shared_too_often == 0
    assert mesh.notes == ("24 hexahedra were cut into 144 tetrahedra",)


def test_diagonals_of_bricks_alternate():
    """A block of 2 x 2 x 2 bricks is its own mirror image, whatever the order of its nodes: nothing leans."""
    for rng in (None, np.random.default_rng(3)):
        points, cells = bricks((2, 2, 2), rng)
        mesh = from_cells(points, {"hexahedron": cells})
        mirrored = mesh.points * [-1, 1, 1] + [2, 0, 0]
        image = [tuple(sorted(map(tuple, mirrored[face].tolist()))) for face in mesh.surface]
        assert set(image) == {tuple(sorted(map(tuple, mesh.points[face].tolist()))) for face in mesh.surface}


def test_all_shapes_side_by_side():
    """A brick, a wedge on its side and a pyramid on its top, with a tetrahedron, fit and keep their volumes."""
    points = np.concatenate([CUBE, [[2.0, 0, 0], [2, 0, 1], [0.5, 0.5, 2], [1.5, -1, 0.5]]])
    cells = {
        "hexahedron": [[0, 1, 2, 3, 4, 5, 6, 7]],
        "wedge": [[1, 8, 2, 5, 9, 6]],
        "pyramid": [[4, 5, 6, 7, 10]],
        "tetra": [[1, 8, 5, 11]],
    }
    mesh = from_cells(points, cells)
    tetra = abs(np.linalg.det(points[[8, 5, 11]] - points[1])) / 6
    assert mesh.volume == pytest.approx(1 + 1 / 2 + 1 / 3 + tetra, rel=1e-12)
    # 1 in the wedge, 2 in the pyramid and so on: a wedge has 3 pieces, a pyramid 2
    assert len(mesh.cells) == 6 + 3 + 2 + 1
    assert quality(from_cells(points[:11], {k: v for k, v in cells.items() if k != "tetra"})).closed_surface
    assert "1 wedge was cut into 3 tetrahedra" in mesh.notes and "1 pyramid was cut into 2 tetrahedra" in mesh.notes


def test_orders_of_nodes():
    """VTK's wedges are turned the other way than Gmsh's; a brick that is inside out is turned, and told."""
    wedge = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    for order in (range(6), (0, 2, 1, 3, 5, 4)):
        mesh = from_cells(wedge, {"wedge": [list(order)]})
        assert mesh.volume == pytest.approx(0.5) and mesh.notes == ("1 wedge was cut into 3 tetrahedra",)
    mesh = from_cells(CUBE, {"hexahedron": [[4, 5, 6, 7, 0, 1, 2, 3]]})
    assert mesh.volume == pytest.approx(1.0) and mesh.notes[1] == "1 hexahedron inside out turned"
    with pytest.raises(MeshError, match=r"hexahedron 0 of .*inside out in part .*nodes in order"):
        from_cells(CUBE, {"hexahedron": [[0, 1, 3, 2, 4, 5, 7, 6]]})


def test_a_warped_brick_is_cut_around_its_middle():
    points = CUBE.copy()
    points[6] = [0.45, 0.45, 0.45]  # this corner pushed in: some cut through the first corner turns inside out
    found = [from_cells(np.roll(points, s, axis=0), {"hexahedron": [(np.arange(8) + s) % 8]}) for s in range(8)]
    assert {len(mesh.cells) for mesh in found} <= {6, 12} and any(len(mesh.points) == 9 for mesh in found)
    assert all((mesh.volumes > 0).all() and mesh.volume > 0.2 for mesh in found)
    assert any("around a new node in the middle" in mesh.notes[0] for mesh in found)


def test_collapsed_bricks_are_wedges_and_tetrahedra():
    """Meshers write wedges as bricks that name a node twice; their empty pieces are no fault."""
    mesh = from_cells(CUBE[[0, 1, 2, 4, 5, 6]], {"hexahedron": [[0, 1, 2, 2, 3, 4, 5, 5]]})
    assert mesh.volume == pytest.approx(0.5) and mesh.notes == ("1 hexahedron was cut into 3 tetrahedra",)
    corner = from_cells(CUBE[[0, 1, 3, 4]], {"hexahedron": [[0, 1, 2, 2, 3, 3, 3, 3]]})
    assert corner.volume == pytest.approx(1 / 6) and len(corner.cells) == 1


def test_quadratic_cells_keep_their_corners():
    rows = np.concatenate([np.arange(8), np.arange(8, 20)])[None]
    points = np.concatenate([CUBE, np.full((12, 3), 0.5)])
    mesh = from_cells(points, {"hexahedron20": rows})
    assert mesh.volume == pytest.approx(1.0) and len(mesh.points) == 8
    assert any("1 quadratic element was made linear" in note for note in mesh.notes)


def test_merging_before_cutting_makes_a_seam_fit():
    """Two bricks with their own nodes on the common face, which would be cut along different diagonals."""
    points, cells = bricks((1, 1, 1))
    second = points[[0, 2, 1, 3, 4, 6, 5, 7]] + [1, 0, 0]
    new = np.array([0, 2, 1, 3, 4, 6, 5, 7])[cells] + 8
    both = np.concatenate([points, second]), {"hexahedron": np.concatenate([cells, new])}
    mesh = from_cells(*both, merge=True)
    report = quality(mesh)
    assert len(mesh.points) == 12 and report.components == 1 and report.surface_area == pytest.approx(10.0)
    assert any("4 nodes were merged with another" in note for note in mesh.notes)
    assert quality(from_cells(*both)).components == 2


def test_bad_input_is_named():
    with pytest.raises(MeshError, match=r'cells "hexahedron" of "mesh" have shape \(1, 6\)'):
        from_cells(CUBE, {"hexahedron": [list(range(6))]})
    with pytest.raises(MeshError, match=r'cells "brick" of "mesh"'):
        from_cells(CUBE, {"brick": [list(range(8))]})
    with pytest.raises(MeshError, match=r"uses a node that does not exist: there are 8"):
        from_cells(CUBE, {"hexahedron": [list(range(1, 9))]})
    with pytest.raises(MeshError, match=r"merge=-1"):
        from_cells(CUBE, {"hexahedron": [list(range(8))]}, merge=-1)


@pytest.mark.parametrize("diagonals", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_tetrahedra_straight_on_bricks_fit(diagonals):
    """Two bricks with two tetrahedra each on top, joined along either diagonal: the bricks are cut as these are.

    Where no order of nodes serves, as for both diagonals at a common edge, a brick gets a node in its middle.
    """
    points, cells = bricks((2, 1, 1))
    tets, tips = [], []
    for number, (cell, odd) in enumerate(zip(cells, diagonals, strict=True)):
        a, b, c, d = np.roll(cell[4:], -odd)
        tip = len(points) + number
        tets += [[a, b, c, tip], [a, c, d, tip]]
        tips.append(points[cell].mean(axis=0) + np.array([0, 0, 1.5]))
    mesh = from_cells(np.concatenate([points, tips]), {"tetra": tets, "hexahedron": cells})
    report = quality(mesh)
    assert mesh.volume == pytest.approx(2 + 2 / 3) and report.closed_surface and report.shared_too_often == 0
    # no face inside is left alone: the outside has 8 squares of two triangles each, and 8 slopes
    assert len(mesh.surface) == 2 * 8 + 8
    assert report.surface_area == pytest.approx(8 + 8 * np.sqrt(1.25) / 2)


def test_wedges_and_bricks_with_tetrahedra_in_any_order():
    """Every second brick of a block as six tetrahedra beforehand: what touches them is cut to fit."""
    points, cells = bricks((3, 2, 2), np.random.default_rng(5))
    some = from_cells(points, {"hexahedron": cells[::2]})
    place = {tuple(p): i for i, p in enumerate(points)}
    tets = np.array([place[tuple(p)] for p in some.points])[some.cells]
    mesh = from_cells(points, {"tetra": tets, "hexahedron": cells[1::2]})
    report = quality(mesh)
    assert mesh.volume == pytest.approx(12) and report.surface_area == pytest.approx(2 * (6 + 6 + 4))
    assert report.closed_surface and report.components == 1
