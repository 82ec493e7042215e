"""Parts of the frames: rigid bodies where they are, what touches and how hard, joints, loads, markers; and ParaView's
own reader opens the index with all of them."""

import importlib.util
import xml.etree.ElementTree as ET

import jax
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.io import FrameWriter, read_frames
from jaxfem.io.pages import write_page

DT = 2e-3


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A ball that lies on a soft block on the ground, a box that hangs from the world, a load, a point; one step."""
    block = jf.SoftBody(
        jf.mesh.box((0.2, 0.2, 0.1), (2, 2, 1)),
        young=1e6,
        poisson=0.3,
        density=1e3,
        name="block",
        damping=0.02,
        loads=[jf.NodalForce("x+", (0.1, 0.0, 0.0))],
    )
    ball = jf.RigidBody(jf.Sphere(0.05), mass=0.5, position=(0.1, 0.1, 0.15), name="ball", orientation=(0.8, 0, 0.6, 0))
    box = jf.RigidBody(jf.Box((0.1, 0.1, 0.2)), mass=1.0, position=(1, 0, 1), orientation=(0.7, 0, 0.7, 0), name="box")
    vertices = np.array([[0.1, 0.1, 0.1], [0.12, 0.1, 0.1], [0.09, 0.12, 0.1], [0.09, 0.08, 0.1]])
    scene = jf.Scene(
        [block, ball, box],
        joints=[jf.BallJoint(None, box, (1, 0, 1.5), name="string")],
        contacts=[
            jf.Contact(block, jf.Plane(), friction=0.1),
            jf.Contact(block, ball, surface=vertices, friction=0.2, name="on"),
        ],
    )
    model, params, state = jf.build(scene)
    folder = tmp_path_factory.mktemp("frames")
    writer = FrameWriter(folder, "run", model, params, {"middle": (0.1, 0.1, 0.05)}, scene=scene, dt=DT)
    states, info = jf.rollout(model, params, state, DT, 60)
    assert not info.status.any()
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    with writer:
        writer.write(state)
        writer.write(last)
    return folder, model, last


@pytest.mark.slow
def test_every_part_is_there_and_where_it_belongs(written):
    folder, _, state = written
    first, frame = read_frames(folder / "run.pvd")
    assert list(frame.parts) == ["rigid", "ground", "joints", "contacts", "loads", "points", "embedded"]
    rigid = frame.parts["rigid"]
    for number in (0, 1):
        own = rigid.points[np.unique(rigid.cells[rigid.cellwise["body"] == number])]
        np.testing.assert_allclose(own.mean(0), state.rigid.positions[number], atol=1e-3)
    box = rigid.points[np.unique(rigid.cells[rigid.cellwise["body"] == 1])]
    np.testing.assert_allclose(np.linalg.norm(box - state.rigid.positions[1], axis=1), 0.15**0.5 / 10**0.5, rtol=1e-6)
    turned = np.asarray(jf.rotation.quaternion_to_matrix(state.rigid.orientations[1]))
    np.testing.assert_allclose(np.abs((box - np.asarray(state.rigid.positions[1])) @ turned), [[0.05, 0.05, 0.1]] * 8)
    np.testing.assert_allclose(rigid.points - rigid.nodal["displacement"], first.parts["rigid"].points, atol=1e-12)
    assert np.ptp(frame.parts["ground"].points[:, 2]) == 0
    assert len(frame.parts["embedded"].points) == 4 and np.abs(frame.parts["embedded"].points[:, 2] - 0.1).max() < 0.01
    np.testing.assert_allclose(frame.parts["points"].points[0], [0.1, 0.1, 0.05], atol=0.01)
    np.testing.assert_allclose(
        frame.parts["loads"].nodal["force"].sum(0), [0.1 * len(frame.parts["loads"].points), 0, 0]
    )


@pytest.mark.slow
def test_forces_balance_weights(written):
    """What carries a body at rest is its weight: the ball's on the block, the block's and the ball's on the ground, the
    box's on its joint."""
    _, frame = read_frames(written[0] / "run.pvd")
    touch = frame.parts["contacts"]
    on = touch.nodal["contact"] == 1
    assert abs(touch.nodal["force"][on].sum(0)[2] + 0.5 * 9.81) < 0.25  # on the block, the first of the two
    assert np.linalg.norm(touch.points[touch.nodal["force"][:, 2] < -1] - [0.1, 0.1, 0.1], axis=1).max() < 0.12
    assert abs(touch.nodal["force"][~on].sum(0)[2] - 4.5 * 9.81) < 2.5
    assert abs(frame.parts["joints"].cellwise["force"][0] - 9.81) < 0.05
    ends = frame.parts["joints"].points
    np.testing.assert_allclose(ends, [[1, 0, 1.5]] * 2, atol=1e-6)


def test_fields_are_those_asked_for(tmp_path):
    built = jf.build(jf.Scene([jf.SoftBody(jf.mesh.box((1, 1, 1), 1), 1e5, 0.3, 1e3)]))
    with FrameWriter(tmp_path, "cube", built[0], built[1], fields=["velocity"]) as writer:
        writer.write(built[2])
    (frame,) = read_frames(writer.index)
    assert list(frame.fields) == ["velocity"]
    with FrameWriter(tmp_path, "cube", built[0], built[1], fields=["stress"]) as writer:
        writer.write(built[2])
    assert read_frames(writer.index)[0].fields["stress"].shape == (len(built[0].elements.cells), 6)
    with FrameWriter(tmp_path, "cube", built[0], built[1], fields=["speed"]) as writer:
        with pytest.raises(jf.SceneError, match=r'no field "speed"; known: .*von_mises'):
            writer.write(built[2])


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("vtkmodules") is None, reason="needs vtk, which ParaView is made of")
def test_paraviews_reader_opens_all(written):

    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    folder, _, _ = written
    entries = list(ET.parse(folder / "run.pvd").getroot().iter("DataSet"))
    assert {entry.attrib["name"] for entry in entries} >= {"bodies", "rigid", "contacts"}
    assert [entry.attrib["part"] for entry in entries] == ["0", "1", "2", "3", "4", "5", "6", "7"] * 2
    for entry in entries:
        reader = vtkXMLUnstructuredGridReader()
        assert reader.CanReadFile(str(folder / entry.attrib["file"]))
        reader.SetFileName(str(folder / entry.attrib["file"]))
        reader.Update()
        grid = reader.GetOutput()
        assert reader.GetErrorCode() == 0 and grid.GetNumberOfPoints() > 0
        assert grid.GetNumberOfCells() > 0


def test_what_touches_nothing_yet_is_no_part_and_the_page_shows_it_later(tmp_path):
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 0.5), name="ball")
    scene = jf.Scene([ball], contacts=[jf.Contact(ball, jf.Plane())])
    model, params, state = jf.build(scene)
    with FrameWriter(tmp_path, "drop", model, params, scene=scene, dt=DT) as writer:
        for height in (0.5, 0.101):
            centre = np.array([[0.0, 0.0, height]])
            writer.write(state.replace(rigid=state.rigid.replace(positions=centre)))
    above, near = read_frames(writer.index)
    assert list(above.parts) == ["rigid", "ground"] and list(near.parts) == ["rigid", "ground", "contacts"]
    np.testing.assert_allclose(near.parts["contacts"].nodal["gap"], [0.001], atol=1e-12)
    path, count = write_page(tmp_path / "drop.html", [above, near], "drop")
    assert count == 2 and '"contacts"' in path.read_text()
