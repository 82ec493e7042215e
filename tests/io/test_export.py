"""Frames, index and tables: what is read back is what was written, and an interruption leaves all of it readable."""

import csv
import os
import xml.etree.ElementTree as ET

import jax.numpy as jnp
import meshio
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.io import FrameWriter, export, read_frames
from jaxfem.io.reading import read_frame
from jaxfem.system.inside import tensors, von_mises

YOUNG, POISSON = 1e5, 0.3


@pytest.fixture(scope="module")
def built():
    parts = [jf.mesh.box((0.2, 0.1, 0.1), (2, 1, 1), origin=(0, y, 0)) for y in (0.0, 1.0)]
    bodies = [jf.SoftBody(part, YOUNG, POISSON, 1000.0, name=name) for part, name in zip(parts, "ab", strict=True)]
    return jf.build(jf.Scene(bodies))


def states(model, state, count):
    generator = np.random.default_rng(1)
    for number in range(count):
        shift, speed = generator.normal(scale=1e-3, size=(2, *model.rest.shape))
        yield state.replace(positions=model.rest + shift, velocities=jnp.asarray(speed), time=jnp.asarray(0.1 * number))


def table(path):
    with open(path) as file:
        return list(csv.reader(file))


def test_round_trip(built, tmp_path):
    model, params, state = built
    kept = list(states(model, state, 3))
    middle = (0.1, 0.05, 0.05)
    with FrameWriter(tmp_path, "run", model, params, {"tip": (0.2, 0.1, 0.1), "middle": middle}) as writer:
        for each in kept:
            writer.write(each)
    frames = read_frames(tmp_path / "run.pvd")
    assert [frame.time for frame in frames] == [0.0, 0.1, 0.2] == writer.times.tolist()
    for frame, each in zip(frames, kept, strict=True):
        np.testing.assert_array_equal(frame.positions, each.positions)
        np.testing.assert_array_equal(frame.velocity, each.velocities)
        np.testing.assert_allclose(frame.positions - frame.displacement, model.rest, atol=1e-15)
        np.testing.assert_array_equal(frame.cells, model.elements.cells)
        np.testing.assert_array_equal(frame.body, np.repeat([0, 1], 12))
    rows = table(tmp_path / "points.csv")
    assert rows[0] == ["time_s", "tip_x_m", "tip_y_m", "tip_z_m", "middle_x_m", "middle_y_m", "middle_z_m"]
    corner = int(np.argmin(np.linalg.norm(model.rest - jnp.array([0.2, 0.1, 0.1]), axis=1)))
    np.testing.assert_allclose(np.array(rows[2][1:4], float), kept[1].positions[corner], rtol=1e-8)
    np.testing.assert_allclose(writer.paths["tip"][2], kept[2].positions[corner], rtol=1e-12)
    np.testing.assert_allclose(writer.paths["middle"][0], middle, atol=5e-3)
    energies = np.array(table(tmp_path / "energies.csv")[1:], float)
    wanted = jf.energies(model, params, kept[1])
    np.testing.assert_allclose(energies[1], [0.1, wanted.kinetic, wanted.elastic, wanted.gravity], rtol=1e-8)


def test_index_is_xml_and_lists_the_frames(built, tmp_path):
    model, params, state = built
    with FrameWriter(tmp_path, "a & b", model, params) as writer:
        for number, each in enumerate(states(model, state, 2), 1):
            writer.write(each)
            root = ET.parse(tmp_path / "a & b.pvd").getroot()  # complete after every frame
            assert root.tag == "VTKFile" and root.attrib["type"] == "Collection" and len(list(root[0])) == number
    entry = root[0][1].attrib
    assert entry["timestep"] == "0.1" and (tmp_path / entry["file"]).is_file()
    assert entry["file"] == "frames/a & b_00001.vtu" and not (tmp_path / "points.csv").exists()


def test_index_of_a_long_run(built, tmp_path, monkeypatch):
    """It is rewritten less and less often, and complete at the end."""
    monkeypatch.setattr(export, "SHORT", 2)
    model, params, state = built
    listed = []
    with FrameWriter(tmp_path, "run", model, params) as writer:
        for each in states(model, state, 7):
            writer.write(each)
            listed.append(len(read_frames(tmp_path / "run.pvd")))
    assert listed[0] == 1 and listed == sorted(listed) and listed[-1] < 7
    assert len(read_frames(tmp_path / "run.pvd")) == 7


def test_frames_of_an_earlier_run_go(built, tmp_path):
    model, params, state = built
    for count in (3, 1):
        with FrameWriter(tmp_path, "run", model, params) as writer:
            (tmp_path / "frames" / "run_mine.vtu").touch()
            for each in states(model, state, count):
                writer.write(each)
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == ["run_00000.vtu", "run_mine.vtu"]
    assert len(read_frames(tmp_path / "run.pvd")) == 1


def test_interruption_while_writing(built, tmp_path, monkeypatch):
    model, params, state = built
    write = meshio.write

    def interrupted(path, mesh, **options):
        if "00002" in str(path):
            write(path, mesh, **options)
            raise KeyboardInterrupt
        write(path, mesh, **options)

    monkeypatch.setattr(meshio, "write", interrupted)
    with pytest.raises(KeyboardInterrupt), FrameWriter(tmp_path, "run", model, params) as writer:
        for each in states(model, state, 4):
            writer.write(each)
    assert len(read_frames(tmp_path / "run.pvd")) == 2 == len(table(tmp_path / "energies.csv")) - 1
    assert len(os.listdir(tmp_path / "frames")) == 2  # no half-written file stays


def test_point_outside(built, tmp_path):
    model, params, _ = built
    with pytest.raises(jf.SceneError, match=r'"tip" at \[0.3, 0, 0\] lies 0.1 m outside .* mesh is \[0.2, 0, 0\]'):
        FrameWriter(tmp_path, "run", model, params, {"tip": (0.3, 0.0, 0.0)})


def test_missing_frames(tmp_path):
    with pytest.raises(FileNotFoundError, match="no index of frames"):
        read_frames(tmp_path / "run.pvd")
    with pytest.raises(FileNotFoundError, match="no frame"):
        read_frame(tmp_path / "run.vtu")


def test_von_mises_stress(built):
    """Uniaxial strain e gives 2 mu e, shear by a small angle sqrt(3) mu angle, turning nothing."""
    model, params, state = built
    mu = YOUNG / (2 * (1 + POISSON))
    turn = np.asarray(jf.rotation.rotation_vector_to_matrix(jnp.array([0.3, -0.8, 0.5])))
    shear = np.array([[1, 1e-4, 0], [0, 1, 0], [0, 0, 1]])
    gradients = {0.02 * mu: turn @ np.diag([1.01, 1, 1]), 1e-4 * mu * 3**0.5: turn @ shear, 0.0: turn}
    for wanted, gradient in gradients.items():
        bent = state.replace(positions=model.rest @ gradient.T)
        stress = von_mises(tensors(model, params, bent)["stress"])
        np.testing.assert_allclose(stress, wanted, rtol=1e-3, atol=1e-6 * mu)
