"""The volume inside a surface: what the mesher is given and gives back, and what is said where it cannot."""

import argparse
import importlib.util
import pathlib

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.cli.mesh_info import length
from jaxfem.io import load_scene

BOX = jf.mesh.box((0.2, 0.1, 0.1), (2, 1, 1))
BUNNY = pathlib.Path(__file__).resolve().parents[3] / "shared" / "data" / "meshes" / "bunny_10k.obj"


@pytest.fixture
def mesher(tmp_path, monkeypatch):
    """A stand-in for pytetwild, of which the body is given."""

    def written(body):
        (tmp_path / "fake").mkdir(exist_ok=True)
        head = "import numpy, os, sys, time\ndef tetrahedralize(points, triangles, edge_length_abs, epsilon, quiet):\n"
        (tmp_path / "fake" / "pytetwild.py").write_text(head + "".join(f"    {line}\n" for line in body))
        monkeypatch.setenv("PYTHONPATH", str(tmp_path / "fake"))

    return written


def filled(mesher):
    np.savez(pathlib.Path(mesher), points=BOX.points, cells=BOX.cells)
    return [
        f"a = numpy.load({mesher!r})",
        "assert points.shape[1] == triangles.shape[1] == 3",
        "return a['points'], a['cells']",
    ]


def test_what_the_mesher_finds_is_a_mesh_that_says_what_was_done(mesher, tmp_path):
    mesher(filled(str(tmp_path / "made.npz")))
    mesh = jf.mesh.from_surface(BOX.points, BOX.surface, 0.05, "part")
    assert mesh.volume == pytest.approx(2e-3) and mesh.name == "part"
    assert f"{len(BOX.surface)} triangles was filled with {len(BOX.cells)} elements" in mesh.notes[-1]
    assert "+0.0 % of the surface's" in mesh.notes[-1]
    holed = jf.mesh.from_surface(BOX.points, BOX.surface[1:], 0.05, "part")
    assert "which is not closed" in holed.notes[-1] and "%" not in holed.notes[-1]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (["time.sleep(60)"], "took longer than 1 s: give a larger size"),
        (["os._exit(11)"], "failed: it ended with code 11"),
        (["raise ValueError('too flat')"], "failed: ValueError: too flat"),
        (["return numpy.zeros((0, 3)), numpy.zeros((0, 4), int)"], "has no inside to fill"),
    ],
)
def test_a_mesher_that_fails_is_told(mesher, body, said):
    mesher(body)
    with pytest.raises(jf.MeshError, match=said):
        jf.mesh.from_surface(BOX.points, BOX.surface, 0.05, seconds=1.0 if "sleep" in body[0] else 60.0)


def test_wrong_arguments():
    for size, closeness in ((-1.0, None), (0.1, 0.0)):
        with pytest.raises(jf.MeshError, match="give a positive number"):
            jf.mesh.from_surface(BOX.points, BOX.surface, size, closeness=closeness)
    with pytest.raises(jf.MeshError, match="give integers"):
        jf.mesh.from_surface(BOX.points, BOX.surface.astype(float))
    with pytest.raises(jf.MeshError, match=r"give \(k, 3\)"):
        jf.mesh.from_surface(BOX.points, BOX.surface + 100)


@pytest.mark.skipif(importlib.util.find_spec("pytetwild") is not None, reason="pytetwild is installed")
def test_without_the_mesher_the_remedy_is_named():
    with pytest.raises(jf.MeshError, match=r"pip install 'jaxfem\[mesh\]'"):
        jf.mesh.from_surface(BOX.points, BOX.surface)


def test_commands_and_scene_files_take_surfaces(mesher, tmp_path, capsys):
    mesher(filled(str(tmp_path / "made.npz")))
    lines = [f"v {x} {y} {z}" for x, y, z in BOX.points * 1e3] + [f"f {a} {b} {c}" for a, b, c in BOX.surface + 1]
    (tmp_path / "part.obj").write_text("\n".join(lines) + "\n")
    assert main(["mesh", "make", str(tmp_path / "part.obj"), "--size", "50mm", "--scale", "1e-3"]) == 0
    said = capsys.readouterr().out
    assert "was filled with" in said and "0.2 x 0.1 x 0.1 m" in said and "part.vtu, part.png" in said
    assert (tmp_path / "part.png").is_file() and len(jf.mesh.read(tmp_path / "part.vtu").cells) == len(BOX.cells)
    body = 'young = 1e5\npoisson = 0.3\ndensity = 1e3\nmesh = { surface = "part.obj", scale = 1e-3, size = 0.05 }\n'
    (tmp_path / "scene.toml").write_text(f"[time]\nstep = 0.01\nsteps = 1\n[[body]]\n{body}")
    file = load_scene(tmp_path / "scene.toml")
    with pytest.warns(jf.MeshWarning, match="was filled with"):
        jf.build(file.scene)


def test_lengths_have_units():
    assert [length(text) for text in ("5mm", "0.005", "2 cm", "1in")] == [0.005, 0.005, 0.02, 0.0254]
    for text in ("5 parsec", "mm", "1.2.3m"):
        with pytest.raises(argparse.ArgumentTypeError, match="is no length"):
            length(text)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("pytetwild") is None, reason="needs pytetwild: pip install 'jaxfem[mesh]'")
@pytest.mark.skipif(not BUNNY.is_file(), reason="needs shared/data")
def test_a_box_and_a_scan_with_a_hole():
    box = jf.mesh.from_surface(BOX.points, BOX.surface, 0.05)
    assert box.volume == pytest.approx(BOX.volume, rel=0.01)
    points, triangles = jf.mesh.read_surface(BUNNY, 0.1)
    corners = points[triangles]
    whole = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    holed = jf.mesh.from_surface(points, triangles[:-200])
    assert holed.volume == pytest.approx(whole, rel=0.05) and len(holed.cells) > 500
