"""The live viewer: frames, colours, playing; with viser where it is installed, else against a stand-in of its calls."""

import importlib.util
import sys
import time
import types

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.io import live
from jaxfem.io.export import FrameWriter
from jaxfem.io.reading import read_frames


@pytest.fixture(scope="module")
def index(tmp_path_factory):
    """Three frames of a cube and a ball that fall on a plane."""
    cube = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), young=1e5, poisson=0.3, density=1e3, name="cube")
    ball = jf.RigidBody(jf.Sphere(0.05), mass=1.0, position=(0.3, 0, 0.1), name="ball")
    scene = jf.Scene([cube, ball], contacts=[jf.Contact(cube, jf.Plane((0, 0, -0.2)))])
    model, params, state = jf.build(scene)
    with FrameWriter(tmp_path_factory.mktemp("run"), "run", model, params, scene=scene, dt=1e-2) as writer:
        for _ in range(3):
            writer.write(state)
            state, _ = jf.step(model, params, state, 1e-2)
    return writer.index


class Handle:
    """A control with a value that calls back."""

    def __init__(self, value):
        self.value = value

    def on_update(self, function):
        self.function = function


class Server:
    """What `live` calls of viser, with what was drawn last by its name."""

    def __init__(self, host, port, verbose):
        self.host, self.port, self.drawn, self.stopped = host, port, {}, False
        self.scene = types.SimpleNamespace(
            set_up_direction=lambda up: None,
            remove_by_name=lambda name: self.drawn.pop(name, None),
            **{
                f"add_{kind}": lambda name, *arrays, kind=kind, **options: self.drawn.update({name: (kind, arrays)})
                for kind in ("mesh_simple", "mesh_trimesh", "point_cloud", "line_segments")
            },
        )
        self.gui = types.SimpleNamespace(
            **{
                f"add_{kind}": lambda label, *_, initial_value, **options: Handle(initial_value)
                for kind in ("slider", "text", "checkbox", "dropdown")
            }
        )

    def atomic(self):
        import contextlib

        return contextlib.nullcontext()

    def get_host(self):
        return self.host

    def get_port(self):
        return self.port

    def stop(self):
        self.stopped = True


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", types.SimpleNamespace(ViserServer=Server))
    trimesh = types.SimpleNamespace(Trimesh=lambda places, cells, **options: (places, cells, options["vertex_colors"]))
    monkeypatch.setitem(sys.modules, "trimesh", trimesh)


def test_every_frame_is_drawn_where_it_is(stand_in, index):
    frames = read_frames(index)
    viewer = live.show(str(index))
    try:
        assert viewer.address == "http://127.0.0.1:8080" and viewer.frame == 0
        for number, frame in enumerate(frames):
            viewer.go(number)
            kind, (places, cells) = viewer.server.drawn["/bodies"]
            assert kind == "mesh_simple" and cells.shape == (12, 3)
            np.testing.assert_allclose(np.sort(places[:, 2]), np.sort(frame.positions[:, 2]), atol=1e-9)
            rigid = viewer.server.drawn["/rigid"][1][0]
            np.testing.assert_allclose(rigid[:, 2].mean(), frame.parts["rigid"].points[:, 2].mean(), atol=1e-9)
        viewer.go(2, "velocity")
        kind, ((places, _, colours),) = viewer.server.drawn["/bodies"]
        assert kind == "mesh_trimesh" and colours.shape == (len(places), 4)
        np.testing.assert_allclose(colours[:, :3], np.broadcast_to(live.RAMP[-1], (len(places), 3)), atol=1)
        viewer.go(0)
        np.testing.assert_allclose(viewer.server.drawn["/bodies"][1][0][2][:, :3] - live.RAMP[0], 0, atol=1)
        with pytest.raises(ValueError, match="no field 'heat' to colour by: give one of plain, "):
            viewer.go(0, "heat")
        with pytest.raises(ValueError, match="no frame 3 of 3"):
            viewer.go(3)
    finally:
        viewer.stop()
    assert viewer.server.stopped


def later(viewer):
    """The frame shown a tenth of a second on."""
    time.sleep(0.1)
    return viewer.frame


def test_it_plays_and_pauses(stand_in, index, monkeypatch):
    monkeypatch.setattr(live, "PACE", 1e-3)
    viewer = live.show(read_frames(index))
    seen = set()
    viewer.play()
    end = time.monotonic() + 60
    while len(seen) < 3 and time.monotonic() < end:
        seen.add(viewer.frame)
        time.sleep(2e-4)
    assert seen == {0, 1, 2}
    viewer.play(False)
    time.sleep(0.1)
    while (still := viewer.frame) != later(viewer) and time.monotonic() < end:
        pass  # the frame that was under way, as late as a busy core makes it
    assert later(viewer) == still
    viewer.stop()


def test_what_is_missing_is_told(index, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(live.LiveError, match=r"pip install 'jaxfem\[live\]'"):
        live.show(index)
    assert main(["view", str(index), "--live"]) == 2
    assert "pip install 'jaxfem[live]'" in capsys.readouterr().err


def test_no_frames(stand_in):
    with pytest.raises(ValueError, match="no frame to show"):
        live.show([])


@pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
def test_with_viser_itself(index):
    viewer = live.show(index, port=8123)
    try:
        for number in range(3):
            viewer.go(number, "velocity" if number else None)
        assert viewer.frame == 2
    finally:
        viewer.stop()
