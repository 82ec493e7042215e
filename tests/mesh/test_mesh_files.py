"""Round trips through file formats, foreign files, and the words for files that cannot be used."""

import meshio
import numpy as np
import pytest

from jaxfem.mesh import MeshError, TetMesh, ball, box, from_convex_surface, read, read_surface, report_text, write


@pytest.fixture
def bar():
    mesh = box((4.0, 1.0, 1.0), (4, 2, 2))
    half = mesh.points[mesh.cells].mean(axis=1)[:, 0] < 2.0
    return TetMesh(mesh.points / 3.0, mesh.cells, "bar", mesh.face_groups, {"tip line": [44, 43]}, {"half": half})


@pytest.mark.parametrize("ending", [".vtu", ".vtk", ".msh", ".node", ".ele", ".mesh", ".inp"])
def test_round_trip(bar, tmp_path, ending):
    lost = write(tmp_path / f"bar{ending}", bar)
    again = read(tmp_path / f"bar{ending}")
    np.testing.assert_allclose(again.points, bar.points, rtol=1e-15)
    np.testing.assert_array_equal(again.cells, bar.cells)
    assert again.name == "bar" and again.notes == ()
    if ending == ".msh":
        assert lost == ()
        assert list(again.face_groups) == ["x-", "x+", "y-", "y+", "z-", "z+"]
        for name in bar.face_groups:
            np.testing.assert_array_equal(again.faces(name), bar.faces(name))
        np.testing.assert_array_equal(again.nodes("tip line"), bar.nodes("tip line"))
        np.testing.assert_array_equal(again.cell_groups["half"], bar.cell_groups["half"])
    else:
        assert "face groups x-, x+" in lost[0] and "write .msh to keep them" in lost[0]


def test_data_and_scale(bar, tmp_path):
    write(tmp_path / "bar.vtu", bar, {"u": bar.points}, {"energy": np.arange(len(bar.cells))})
    raw = meshio.read(tmp_path / "bar.vtu")
    np.testing.assert_array_equal(raw.point_data["u"], bar.points)
    np.testing.assert_array_equal(raw.cell_data["energy"][0], np.arange(len(bar.cells)))
    assert read(tmp_path / "bar.vtu", scale=1e-3, name="small").volume == pytest.approx(bar.volume * 1e-9)
    with pytest.raises(MeshError, match=r'cell data "energy" has shape \(3,\): its first length must be 96'):
        write(tmp_path / "bar.vtu", bar, cell_data={"energy": np.zeros(3)})
    assert "cell data energy is not kept in .msh" in write(tmp_path / "a.msh", bar, None, {"energy": bar.volumes})[-1]
    with pytest.raises(MeshError, match="scale=-1"):
        read(tmp_path / "bar.vtu", scale=-1)


def test_groups_that_msh_cannot_keep_are_told(bar, tmp_path):
    twice = TetMesh(bar.points, bar.cells, "bar", {"a": bar.faces("x-")}, {"a": [0]}, {"b": [0, 1], "c": [1, 2]})
    lost = write(tmp_path / "bar.msh", twice)
    assert len(lost) == 2 and "name is taken" in lost[0] and "overlaps another cell group" in lost[1]


GMSH41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "base"
3 2 "rubber"
$EndPhysicalNames
$Entities
0 0 1 1
1 0 0 0 1 1 0 1 1 0
1 0 0 0 1 1 1 1 2 0
$EndEntities
$Nodes
1 4 1 4
3 1 0 4
1
2
3
4
0 0 0
1 0 0
0 1 0
0 0 1
$EndNodes
$Elements
2 2 1 2
2 1 2 1
1 1 2 3
3 1 4 1
2 1 2 3 4
$EndElements
"""


def test_gmsh_41_groups(tmp_path):
    (tmp_path / "part.msh").write_text(GMSH41)
    mesh = read(tmp_path / "part.msh")
    assert mesh.faces("base").tolist() == [[0, 2, 1]] and mesh.cell_groups["rubber"].tolist() == [0]


def test_tetgen_files_from_one_with_markers_and_comments(tmp_path):
    (tmp_path / "a.node").write_text("# nodes\n4 3 0 1\n1 0 0 0 5\n2\t1 0 0 5 # two\n3 0 1 0 5\n4 0 0 1 0\n# end\n")
    (tmp_path / "a.ele").write_text("1 4 1\n1 1 2 3 4 1.0\n")
    (tmp_path / "a.face").write_text("1 1\n1 1 2 3 5\n")
    for ending in (".node", ".ele"):
        mesh = read(tmp_path / f"a{ending}")
        assert mesh.volume == pytest.approx(1 / 6) and mesh.faces("5").tolist() == [[0, 2, 1]]
    (tmp_path / "a.ele").write_text("2 4 0\n1 1 2 3 4\n")
    with pytest.raises(MeshError, match="promises 2 rows and holds 1: the file is cut short"):
        read(tmp_path / "a.node")
    (tmp_path / "a.ele").unlink()
    with pytest.raises(FileNotFoundError, match=r"needs a\.ele beside it"):
        read(tmp_path / "a.node")


def test_armadillo(data):
    mesh = read(data / "meshes" / "armadillo_4k.node")
    assert mesh.points.shape == (1180, 3) and mesh.cells.shape == (3717, 4)
    assert (mesh.volumes > 0).all() and len(mesh.surface) == 2102
    assert "1180" in report_text(data / "meshes" / "armadillo_4k.ele")


def test_bunny_is_a_surface(data):
    path = data / "meshes" / "bunny_10k.obj"
    with pytest.raises(
        MeshError, match=r"holds a surface \(10000 triangle\), which has no volume: .*from_convex_surface"
    ):
        read(path)
    points, triangles = read_surface(path)
    assert triangles.shape == (10000, 3) and triangles.max() == len(points) - 1
    with pytest.raises(MeshError, match="not convex"):
        from_convex_surface(points, triangles)


def test_mixed_quadratic_and_dirty_cells(tmp_path):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    middles = [(corners[a] + corners[b]) / 2 for a, b in ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))]
    points = np.concatenate([corners, middles, [[0, 0, -1.0]]])
    blocks = [
        ("tetra10", [[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]]),
        ("tetra", [[0, 1, 2, 10], [10, 0, 1, 2]]),
        ("quad", [[0, 1, 5, 2]]),
    ]
    meshio.Mesh(points, blocks).write(tmp_path / "mixed.vtu")
    mesh = read(tmp_path / "mixed.vtu")
    assert mesh.volume == pytest.approx(1 / 3) and len(mesh.points) == 5
    text = "; ".join(mesh.notes)
    for part in (
        "1 quadratic element was made linear",
        "left out: 1 quad",
        "flipped: 1",
        "earlier one was dropped: 2",
    ):
        assert part in text
    assert "6 nodes without an element were dropped: 4, 5" in text


def test_files_without_a_volume(tmp_path):
    cube = box((1.0, 1.0, 1.0), 1).points[[0, 4, 6, 2, 1, 5, 7, 3]]
    for name, quads in (("shell.vtk", [[0, 1, 2, 3], [4, 5, 6, 7]]), ("shell.vtu", [[0, 1, 2, 3]])):
        meshio.Mesh(cube, [("quad", quads)]).write(tmp_path / name)
        with pytest.raises(MeshError, match=r"holds a surface \(\d quad\), which has no volume"):
            read(tmp_path / name)
        assert read_surface(tmp_path / name)[1].shape == (2 * len(quads), 3)
    meshio.Mesh(cube, [("line", [[0, 1]])]).write(tmp_path / "wire.vtu")
    with pytest.raises(MeshError, match=r"no tetrahedra in .*wire.vtu: found 1 line; mesh the volume"):
        read(tmp_path / "wire.vtu")


def test_surface_files(tmp_path):
    shell = ball(1.0, 2)
    for ending in (".stl", ".ply", ".obj", ".off"):
        raw = meshio.Mesh(shell.points.astype(np.float32), [("triangle", shell.surface)])
        raw.write(tmp_path / f"shell{ending}")
        points, triangles = read_surface(tmp_path / f"shell{ending}", scale=2.0)
        assert len(points) == len(shell.surface_nodes) and len(triangles) == len(shell.surface)
        assert from_convex_surface(points, triangles).volume == pytest.approx(8 * shell.volume, rel=1e-3)


def test_files_that_cannot_be_read(tmp_path, capfd, bar):
    write(tmp_path / "there.vtu", bar)
    with pytest.raises(FileNotFoundError, match=r"no mesh file .*nope.msh: the folder holds there.vtu"):
        read(tmp_path / "nope.msh")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        read(tmp_path / "away" / "nope.msh")
    for ending in (".msh", ".vtu", ".vtk", ".inp", ".mesh", ".node", ".obj"):
        (tmp_path / f"bad{ending}").write_text("garbage\nv x y\n")
        (tmp_path / "bad.ele").write_text("garbage\n")
        with pytest.raises(MeshError, match=f"bad{ending}"):
            read(tmp_path / f"bad{ending}")
    (tmp_path / "bad.foo").write_text("")
    with pytest.raises(MeshError, match=r'ending ".foo", of no known mesh format: known are .*\.msh'):
        read(tmp_path / "bad.foo")
    with pytest.raises(MeshError, match=r'ending ".foo"'):
        write(tmp_path / "bar.foo", bar)
    out = capfd.readouterr()
    assert out.out == "" and out.err == ""
