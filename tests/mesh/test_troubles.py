"""What is told of a mesh that can be used: seams, parts, flat elements, doubtful units; and how a seam is mended."""

import warnings

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.building.soft import check_body
from jaxfem.io.scene_files import SceneFileError, load_scene
from jaxfem.mesh import MeshError, MeshWarning, TetMesh, box, read, read_surface, write
from jaxfem.mesh.topology import components
from jaxfem.mesh.troubles import troubles

SEAM = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]])
HALVES = [[0, 1, 2, 3], [4, 5, 6, 7]]


def torn(noise=0.0, name="torn"):
    points = SEAM + noise * np.random.default_rng(0).uniform(-1, 1, SEAM.shape)
    return TetMesh(points, HALVES, name, node_groups={"seam": [4, 5, 6]}, cell_groups={"far": [1]})


def told(mesh):
    """What `build` warns of."""
    body = jf.SoftBody(mesh, young=1e5, poisson=0.3, density=1e3)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        check_body(body, body.label)
    assert all(issubclass(each.category, MeshWarning) for each in found)
    return [str(each.message) for each in found]


@pytest.mark.parametrize("noise", [0.0, 1e-9])
def test_a_seam_is_told_and_mended(noise):
    """Nodes that differ by the rounding of a file are the same; groups follow to those that stay."""
    said = told(torn(noise))
    assert said[0] == 'mesh of "torn": the mesh falls into 2 parts that share no node'
    assert "6 nodes lie on top of another: merge them" in said[1] and "merge = true" in said[1]
    whole = torn(noise).merged()
    assert len(whole.points) == 5 and components(whole.cells, 5) == 1 and troubles(whole) == ()
    assert whole.nodes("seam").tolist() == [1, 2, 3] and whole.cell_groups["far"].tolist() == [1]
    assert "3 nodes were merged with another" in whole.notes[0] and len(told(whole)) == 1


def test_merging_within_a_distance():
    assert len(torn(1e-4).merged(1e-3).points) == 5 and len(torn(1e-4).merged().points) == 8
    assert "no node lies within" in torn(1e-4).merged().notes[0]
    with pytest.raises(MeshError, match="distance -1"):
        torn().merged(-1)


def test_a_grid_of_many_close_nodes_is_no_seam():
    """The search along one direction must find doubled nodes and nothing else."""
    mesh = box((1.0, 1.0, 1.0), 6)
    assert troubles(mesh) == ()
    rng = np.random.default_rng(0)
    order = rng.permutation(2 * len(mesh.points))
    points = np.empty((len(order), 3))
    points[order] = np.concatenate([mesh.points, mesh.points])
    twice = TetMesh(points, order[np.concatenate([mesh.cells, mesh.cells + len(mesh.points)])])
    assert any(f"{len(order)} nodes lie on top" in each for each in troubles(twice))
    assert len(twice.merged().cells) == len(mesh.cells) and twice.merged().volume == pytest.approx(1.0)


def test_parts_are_counted_however_long_their_chains():
    chain = np.arange(200)[:, None] + np.arange(4)
    assert components(np.concatenate([chain, chain + 300]), 503) == 2 + (300 - 203)
    shuffled = np.random.default_rng(1).permutation(503)
    assert components(shuffled[np.concatenate([chain, chain + 300])], 503) == 99


def test_flat_elements_are_told_and_needles_are_not():
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    flat = TetMesh(corner * [1, 1, 0.05], [[0, 1, 2, 3]], "flat")
    assert "element 0 is nearly flat (smallest angle" in told(flat)[0] and "remesh" in told(flat)[0]
    assert troubles(TetMesh(corner * [1, 1, 20.0], [[0, 1, 2, 3]])) == ()
    report = jf.mesh.quality(flat)
    assert report.warnings()[0] in told(flat)[0]


def test_what_was_lost_on_reading_is_told(tmp_path):
    (tmp_path / "part.inp").write_text(
        "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n9,5,5,5\n*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n2,1,2,2,4\n3,1,2,4,3\n"
    )
    said = " ".join(told(read(tmp_path / "part.inp")))
    for part in ("1 node without an element was dropped", "naming a node twice was dropped", "earlier one was dropped"):
        assert part in said


@pytest.mark.parametrize(("length", "asked"), [(60.0, "60 m long: are these mm?"), (5e-5, "5e-05 m long"), (0.1, None)])
def test_units_are_asked_for_and_never_guessed(tmp_path, length, asked):
    write(tmp_path / "part.vtu", box((length, length / 3, length / 3), (3, 1, 1)))
    mesh = read(tmp_path / "part.vtu")
    assert np.ptp(mesh.points[:, 0]) == pytest.approx(length)
    assert [asked in note for note in mesh.notes] == ([True] if asked else [])
    assert [asked in each for each in told(mesh)] == ([True] if asked else [])
    assert read(tmp_path / "part.vtu", scale=1.0).notes == () == read(tmp_path / "part.vtu", scale=2.0).notes


def test_surfaces_are_asked_too(tmp_path):
    (tmp_path / "skin.obj").write_text("v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\nf 1 2 3\nf 1 2 4\n")
    with pytest.warns(MeshWarning, match=r'"skin.obj" is 60 m long: are these mm\? Then give scale = 1e-3'):
        read_surface(tmp_path / "skin.obj")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_surface(tmp_path / "skin.obj", scale=1e-3)[0].max() == pytest.approx(0.06)


SCENE = """
time = { step = 0.01, steps = 1 }
[[body]]
mesh = { file = "torn.vtu", merge = MERGE }
young = 1e5
poisson = 0.3
density = 1e3
"""


def test_merge_in_scene_files(tmp_path):
    write(tmp_path / "torn.vtu", torn())
    for merge, nodes in (("true", 5), ("1e-6", 5), ("false", 8)):
        (tmp_path / "scene.toml").write_text(SCENE.replace("MERGE", merge))
        (body,) = load_scene(tmp_path / "scene.toml").scene.soft
        assert len(body.mesh.points) == nodes
    for merge in ('"yes"', "-1.0", "[]"):
        (tmp_path / "scene.toml").write_text(SCENE.replace("MERGE", merge))
        with pytest.raises(SceneFileError, match=r"merge=.* give true, false or a distance in m"):
            load_scene(tmp_path / "scene.toml")
