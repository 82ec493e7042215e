"""Fine surfaces in coarse bodies: carried exactly, written as frames of their own, used for contact."""

import importlib.util
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.io.export import FrameWriter
from jaxfem.io.reading import read_part
from jaxfem.io.scene_files import load_scene
from jaxfem.io.skins import skin

SPHERE = jf.mesh.ball(0.05, 4)


def caged(**more):
    cage = jf.mesh.cage(SPHERE.points, SPHERE.surface, elements=300)
    return jf.SoftBody(cage, young=1e5, poisson=0.3, density=500.0, surface=(SPHERE.points, SPHERE.surface), **more)


def written(path):
    with path.open("w") as file:
        file.writelines(f"v {x} {y} {z}\n" for x, y, z in SPHERE.points)
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in SPHERE.surface + 1)


@pytest.mark.filterwarnings("ignore::jaxfem.MeshWarning")
def test_a_surface_in_an_affinely_deformed_cage_is_exact():
    body = caged()
    scene = jf.Scene([body, caged()])
    drawn = skin(scene)
    matrix = np.array([[1.2, 0.3, 0.0], [-0.1, 0.8, 0.2], [0.0, 0.4, 1.1]])
    places = np.concatenate([body.mesh.points, body.mesh.points]) @ matrix.T + [1, 2, 3]
    expected = SPHERE.points @ matrix.T + [1, 2, 3]
    np.testing.assert_allclose(drawn.carried(places), np.concatenate([expected, expected]), atol=1e-14)
    assert set(drawn.number) == {0, 1} and drawn.triangles.max() == 2 * len(SPHERE.points) - 1


@pytest.mark.filterwarnings("ignore::jaxfem.MeshWarning")
def test_frames_hold_surface_and_cage(tmp_path):
    body = caged(velocity=(1.0, 0.0, 0.0))
    scene = jf.Scene([body], gravity=(0, 0, 0))
    model, params, state = jf.build(scene)
    with FrameWriter(tmp_path, "run", model, params, scene=scene) as writer:
        writer.write(state)
    part = read_part(writer.saved[0].parts["surface"])
    np.testing.assert_allclose(part.points, SPHERE.points, atol=1e-7)
    np.testing.assert_allclose(part.nodal["velocity"], np.tile([1.0, 0, 0], (len(part.points), 1)), atol=1e-6)
    assert len(part.cells) == len(SPHERE.surface) and "run_00000_surface" in (tmp_path / "run.pvd").read_text()


@pytest.mark.skipif(importlib.util.find_spec("vtkmodules") is None, reason="needs vtk, which ParaView is made of")
@pytest.mark.filterwarnings("ignore::jaxfem.MeshWarning")
def test_vtks_reader_opens_surface_and_cage(tmp_path):
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    body = caged()
    scene = jf.Scene([body], gravity=(0, 0, 0))
    model, params, state = jf.build(scene)
    with FrameWriter(tmp_path, "run", model, params, scene=scene) as writer:
        writer.write(state)
    wanted = {"bodies": body.mesh.cells.shape[0], "surface": len(SPHERE.surface)}
    for entry in ET.parse(tmp_path / "run.pvd").getroot().iter("DataSet"):
        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(tmp_path / entry.attrib["file"]))
        reader.Update()
        assert reader.GetErrorCode() == 0
        assert reader.GetOutput().GetNumberOfCells() == wanted.pop(entry.attrib["name"])
    assert not wanted


def test_points_outside_are_warned_of():
    tight = jf.mesh.box((0.08, 0.08, 0.08), 1, origin=(-0.04, -0.04, -0.04))
    body = jf.SoftBody(tight, young=1e5, poisson=0.3, density=5e2, surface=(SPHERE.points, SPHERE.surface))
    with pytest.warns(jf.MeshWarning, match="lie outside the mesh, up to 0.0"):
        drawn = skin(jf.Scene([body]))
    np.testing.assert_allclose(drawn.carried(tight.points), SPHERE.points, atol=1e-12)  # at rest they stay


def test_a_scene_file_drops_a_surface_in_a_cage(tmp_path):
    written(tmp_path / "ball.obj")
    (tmp_path / "scene.toml").write_text(
        "[time]\nstep = 0.01\nsteps = 10\nsave_every = 5\n"
        '[[body]]\nname = "ball"\nmesh = { cage = "ball.obj", elements = 300 }\nposition = [0, 0, 0.06]\n'
        "young = 1e5\npoisson = 0.3\ndensity = 500.0\ndamping = 0.01\n"
        '[[contact]]\na = "ball"\nground = { plane = [0, 0, 1] }\nsurface = true\n'
    )
    file = load_scene(tmp_path / "scene.toml")
    points, triangles = file.scene.soft[0].surface
    corners = SPHERE.points[SPHERE.surface] + np.array([0, 0, 0.06])
    np.testing.assert_allclose(points[triangles].sum((0, 1)), corners.sum((0, 1)), atol=1e-9)
    assert main(["simulate", str(tmp_path / "scene.toml"), "--no-plots"]) == 0
    part = read_part(sorted((tmp_path / "scene_results" / "frames").glob("*_surface.vtu"))[-1])
    assert -1e-4 < part.points[:, 2].min() < 5e-3  # it stands on its own skin, with the cage below the plane


@pytest.mark.parametrize(
    "surface, words",
    [((SPHERE.points, SPHERE.surface + 10**6), "not among"), (SPHERE.points, "pair"), ((SPHERE.points, []), "pair")],
)
def test_what_is_no_surface_is_refused(surface, words):
    with pytest.raises(jf.SceneError, match=words):
        jf.SoftBody(SPHERE, young=1e5, poisson=0.3, density=5e2, surface=surface)


def test_contact_with_a_surface_that_is_not_there_is_refused():
    body = jf.SoftBody(SPHERE, young=1e5, poisson=0.3, density=5e2)
    with pytest.raises(jf.SceneError, match="which has none"):
        jf.build(jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), surface=True)]))
