"""What a TetMesh refuses, what it repairs, and what it tells about itself."""

import numpy as np
import pytest

from jaxfem.mesh import MeshError, TetMesh, box

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
CELLS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])  # volumes 1/6 and 1/3


def changed(row, column, value):
    points = POINTS.copy()
    points[row, column] = value
    return points


@pytest.mark.parametrize(
    ("points", "cells", "message"),
    [
        (POINTS[:, :2], CELLS, r'points of "part" have shape \(5, 2\): give \(n, 3\)'),
        (changed(3, 1, np.nan), CELLS, r'node 3 of "part" is at \(0, nan, 1\)'),
        (changed(2, 0, np.inf), CELLS, r'node 2 of "part" is at \(inf, 1, 0\)'),
        (POINTS, CELLS.astype(float), r'cells of "part" are of type float64: give integers'),
        (POINTS, CELLS[:, :2], r'cells of "part" have shape \(2, 2\)'),
        (POINTS, np.zeros((0, 4), int), r'"part" has no elements'),
        (POINTS, CELLS + 1, r'element 1 of "part" uses node 5, which does not exist: .* from 1: subtract 1'),
        (POINTS, [[0, 1, 2, 9]], r'element 0 of "part" uses node 9, which does not exist: nodes are 0 to 4'),
        (POINTS, [[0, 1, 2, 3], [1, 2, 2, 4]], r'element 1 of "part" names a node twice \(nodes 1, 2, 2, 4\)'),
        (
            changed(4, slice(None), [1, 1, -1]),
            CELLS,
            r'element 1 of "part" has zero volume \(.* m\^3\): TetMesh.repaired',
        ),
        (POINTS, [*CELLS, [3, 2, 1, 0]], r'elements 0 and 2 of "part" have the same nodes \(3, 2, 1, 0\)'),
        (POINTS, CELLS[:1], r'node belongs to no element of "part": 4'),
        (POINTS, np.zeros((1, 8), int), r"8 columns: these are hexahedra: .*from_cells"),
        (POINTS, np.zeros((1, 10), int), r"10 columns: .*quadratic.* use only the first four columns"),
        (POINTS, np.zeros((1, 3), int), r"3 columns: these are triangles, a surface without volume"),
    ],
)
def test_unusable_input_is_named(points, cells, message):
    with pytest.raises(MeshError, match=message):
        TetMesh(points, cells, name="part")


def test_inside_out_elements_are_flipped_and_noted():
    mesh = TetMesh(POINTS, [[0, 2, 1, 3], [1, 2, 3, 4]])
    assert mesh.cells[0].tolist() == [0, 2, 3, 1]
    np.testing.assert_allclose(mesh.volumes, [1 / 6, 1 / 3])
    assert mesh.notes == ("1 element was oriented inside out and was flipped: 0",)
    assert TetMesh(mesh.points, mesh.cells).notes == ()


def test_repaired_drops_and_renumbers():
    points = np.concatenate([[[9.0, 9, 9]], POINTS, [[2.0, 0, 0]]])
    cells = [[1, 1, 2, 3], [1, 2, 3, 4], [1, 2, 6, 1], [2, 1, 4, 3], [1, 2, 6, 2], [2, 4, 3, 5]]
    mesh = TetMesh.repaired(
        points,
        cells,
        "part",
        face_groups={"base": [[1, 2, 3], [0, 1, 2]]},
        node_groups={"ends": [0, 5]},
        cell_groups={"second": [0, 5]},
    )
    assert len(mesh.points) == 5 and len(mesh.cells) == 2
    assert mesh.nodes("ends").tolist() == [4] and mesh.cell_groups["second"].tolist() == [1]
    assert mesh.faces("base").shape == (1, 3)
    text = "; ".join(mesh.notes)
    assert "3 elements naming a node twice were dropped: 0, 2, 4" in text
    assert "1 element with the nodes of an earlier one was dropped: 3" in text
    assert "2 nodes without an element were dropped: 0, 6" in text
    assert "1 element was oriented inside out and was flipped: 5" in text
    assert 'face group "base": 1 of 2 triangles are no face of any element' in text


def test_repaired_drops_flat_elements_but_not_everything():
    flat = changed(4, slice(None), [1, 1, -1])
    mesh = TetMesh.repaired(flat, CELLS)
    assert len(mesh.cells) == 1 and "1 element without volume was dropped: 1" in mesh.notes
    with pytest.raises(MeshError, match="no usable element is left"):
        TetMesh.repaired(flat, CELLS[1:])


def test_surface_is_closed_and_outward():
    mesh = box((2.0, 1.0, 1.0), (3, 2, 2))
    a, b, c = (mesh.points[mesh.surface[:, i]] for i in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(2.0)  # divergence theorem
    np.testing.assert_allclose(np.cross(b - a, c - a).sum(axis=0), 0.0, atol=1e-12)
    assert len(mesh.surface_nodes) == len(mesh.points) - 2 * 1 * 1
    euler = len(mesh.points) - len(mesh.edges) + (4 * len(mesh.cells) + len(mesh.surface)) // 2 - len(mesh.cells)
    assert euler == 1


def test_groups():
    mesh = box((2.0, 1.0, 1.0), (2, 1, 1))
    middle = mesh.points[:, 0] == 1.0
    made = TetMesh(
        mesh.points, mesh.cells, "bar", {"left": mesh.faces("x-")[:, ::-1]}, {"middle": middle}, {"first": [0]}
    )
    assert made.nodes("middle").tolist() == np.flatnonzero(middle).tolist()
    assert made.nodes("left").tolist() == [0, 1, 2, 3] and len(made.nodes("first")) == 4
    np.testing.assert_array_equal(np.sort(made.faces("left"), axis=1), np.sort(mesh.faces("x-"), axis=1))
    a, b, c = (made.points[made.faces("left")[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 0] < 0).all()  # turned outward again
    assert len(made.faces("surface")) == len(made.surface)
    with pytest.raises(MeshError, match='no face group "right" in "bar": it has "left", "surface"'):
        made.faces("right")
    with pytest.raises(MeshError, match='no node group "tip" in "bar": it has "middle", "left", "first", "surface"'):
        made.nodes("tip")


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ({"face_groups": {"f": [[0, 1, 4]]}}, 'triangle 0 of face group "f" of "mesh" is not a face of any element'),
        ({"face_groups": {"f": [[0, 1]]}}, r'face group "f" of "mesh" has shape'),
        ({"node_groups": {"n": [5]}}, 'node group "n" of "mesh" holds number 5: numbers run from 0 to 4'),
        ({"node_groups": {"n": [0.5]}}, 'numbers in node group "n" of "mesh" are of type float64'),
        ({"cell_groups": {"c": [True]}}, r'cell group "c" of "mesh" is a mask of shape \(1,\): give \(2,\)'),
    ],
)
def test_bad_groups_are_named(groups, message):
    with pytest.raises(MeshError, match=message):
        TetMesh(POINTS, CELLS, **groups)


def test_moved_meshes_keep_volume_and_groups():
    mesh = box((2.0, 1.0, 1.0), 2)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert mesh.scaled(1e-3).volume == pytest.approx(2e-9)
    np.testing.assert_allclose(mesh.translated((1, 2, 3)).bounds, [[1, 2, 3], [3, 3, 4]])
    np.testing.assert_allclose(mesh.rotated(turn).bounds, [[-1, 0, 0], [0, 2, 1]], atol=1e-15)
    assert mesh.rotated(turn).renamed("b").name == "b" and list(mesh.rotated(turn).face_groups) == list(
        mesh.face_groups
    )
    for bad in (-1.0, 0.0, np.nan):
        with pytest.raises(MeshError, match="scale factor"):
            mesh.scaled(bad)
    with pytest.raises(MeshError, match="no rotation"):
        mesh.rotated(np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(MeshError, match="offset of shape"):
        mesh.translated(1.0)


def test_arrays_are_copies_and_read_only():
    points = POINTS.copy()
    mesh = TetMesh(points, CELLS)
    points[0] = 7.0
    assert mesh.points[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        mesh.points[0, 0] = 1.0
