"""CAD models: what Gmsh makes of them where it is installed, and what is said where it is not or fails."""

import importlib.util
import pathlib

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.io import load_scene

try:
    import gmsh
except (ImportError, OSError):
    gmsh = None

BOX = jf.mesh.box((0.08, 0.02, 0.01), (4, 1, 1))


@pytest.fixture
def mesher(tmp_path, monkeypatch):
    """A stand-in for Gmsh: every call succeeds, `write` runs the given lines with the target's path."""

    def written(body):
        (tmp_path / "fake").mkdir(exist_ok=True)
        lines = "".join(f"    {line}\n" for line in body)
        text = (
            "import os, shutil, sys, time\nclass Any:\n    def __getattr__(self, name): return Any()\n"
            "    def __call__(self, *a, **k): return Any()\n    def __iter__(self): return iter(())\n"
            "    def __len__(self): return 1\n    def __getitem__(self, key):\n"
            "        return 0.0 if isinstance(key, int) else (0.0,)\n"
            "initialize = finalize = Any()\noption = model = Any()\ndef write(target):\n" + lines
        )
        (tmp_path / "fake" / "gmsh.py").write_text(text)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path / "fake"))

    (tmp_path / "part.step").write_text("ISO-10303-21;")
    return written


def test_what_gmsh_writes_is_the_mesh(mesher, tmp_path, capsys):
    jf.mesh.write(tmp_path / "made.msh", BOX)
    mesher([f"shutil.copy({str(tmp_path / 'made.msh')!r}, target)"])
    mesh = jf.mesh.from_cad(tmp_path / "part.step", 5e-3)
    assert mesh.volume == pytest.approx(BOX.volume) and mesh.name == "part"
    assert "part.step was filled with" in mesh.notes[-1]
    assert main(["mesh", "make", str(tmp_path / "part.step"), "--size", "5mm", "--finest", "1mm", "--no-plots"]) == 0
    assert "wrote part.vtu" in capsys.readouterr().out
    (tmp_path / "scene.toml").write_text(
        '[time]\nstep = 0.01\nsteps = 1\n[[body]]\nmesh = { cad = "part.step", size = 0.005 }\nyoung = 1e5\n'
        "poisson = 0.3\ndensity = 1e3\n"
    )
    (body,) = load_scene(tmp_path / "scene.toml").scene.bodies
    assert len(body.mesh.cells) == len(BOX.cells)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (["time.sleep(60)"], "took longer than 1 s: give a larger size"),
        (["os._exit(11)"], "failed: it ended with code 11"),
        (["raise ValueError('too thin')"], "failed: ValueError: too thin"),
        (["sys.exit('no volume')"], "holds no volume to mesh"),
        (["sys.exit('no gmsh: none')"], r"pip install 'jaxfem\[cad\]'"),
    ],
)
def test_a_mesher_that_fails_is_told(mesher, tmp_path, body, said):
    mesher(body)
    with pytest.raises(jf.MeshError, match=said):
        jf.mesh.from_cad(tmp_path / "part.step", 5e-3, seconds=1.0 if "sleep" in body[0] else 60.0)


def test_wrong_arguments(tmp_path):
    (tmp_path / "part.step").write_text("")
    with pytest.raises(jf.MeshError, match=r"is no CAD model: give one of \.step"):
        jf.mesh.from_cad(tmp_path / "part.stl")
    with pytest.raises(jf.MeshError, match="there is no file"):
        jf.mesh.from_cad(tmp_path / "other.step")
    with pytest.raises(jf.MeshError, match=r"finest for .part. is -1"):
        jf.mesh.from_cad(tmp_path / "part.step", finest=-1)
    with pytest.raises(jf.MeshError, match="more than its size"):
        jf.mesh.from_cad(tmp_path / "part.step", 1e-3, finest=2e-3)
    assert main(["mesh", "make", str(tmp_path / "part.step"), "--scale", "1e-3"]) == 2
    (tmp_path / "part.stl").write_text("")
    assert main(["mesh", "make", str(tmp_path / "part.stl"), "--finest", "1mm"]) == 2


@pytest.mark.skipif(importlib.util.find_spec("gmsh") is not None, reason="Gmsh is installed")
def test_without_gmsh_the_remedy_is_named(tmp_path):
    (tmp_path / "part.step").write_text("")
    with pytest.raises(jf.MeshError, match=r"pip install 'jaxfem\[cad\]'"):
        jf.mesh.from_cad(tmp_path / "part.step")


@pytest.mark.skipif(gmsh is None, reason="Gmsh is not installed, or its library lacks some of the system's")
def test_a_bracket_in_millimetres(tmp_path):
    """A plate of 80 x 20 x 10 mm with a hole of radius 4 mm: its volume, its faces as groups, finer where curved."""
    path = str(pathlib.Path(tmp_path) / "bracket.step")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    plate, hole = gmsh.model.occ.addBox(0, 0, 0, 80, 20, 10), gmsh.model.occ.addCylinder(60, 10, -5, 0, 0, 20, 4)
    gmsh.model.occ.cut([(3, plate)], [(3, hole)])
    gmsh.model.occ.synchronize()
    gmsh.write(path)
    gmsh.finalize()
    coarse, graded = jf.mesh.from_cad(path, 5e-3), jf.mesh.from_cad(path, 5e-3, finest=1e-3)
    exact = (80 * 20 * 10 - np.pi * 4**2 * 10) * 1e-9
    assert abs(graded.volume / exact - 1) < 2e-3 and abs(graded.volume - exact) < abs(coarse.volume - exact)
    assert len(coarse.face_groups) == 7 and len(graded.cells) > len(coarse.cells)
    assert set(coarse.cell_groups) == {"volume 1"}
