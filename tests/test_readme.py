"""What the README shows is true: its code runs, its files load, its commands and folders exist."""

import pathlib
import re
import shlex
import tomllib

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli.main import parser
from jaxfem.fitting import attach, marker_positions, read_recording, write_recording
from jaxfem.io import load_scene
from jaxfem.io.fit_files import load_fit

ROOT = pathlib.Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The fenced blocks of one language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def files() -> dict[str, str]:
    """TOML blocks by the file name in their first line; those without one are parts of a file."""
    named = {}
    for block in blocks("toml"):
        name = re.fullmatch(r"# (\S+\.toml)", block.splitlines()[0])
        if name:
            named[name[1]] = block
    return named


def test_the_readme_opens_with_the_two_commands():
    run, check = blocks("sh")
    assert TEXT.index(run) < TEXT.index(check) < 1000
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for command, extra in ((run, "cli"), (check, "test")):
        assert f"pip install -e '.[{extra}]' && " in command and extra in extras
    assert parser().parse_args(shlex.split(run.split("&& ")[-1])[1:]).out == "demo"
    assert check.strip().endswith("python -m pytest -n auto")
    assert any(need.startswith("pytest-xdist") for need in extras["test"])


def make_recording(path: pathlib.Path) -> None:
    """The recording that the README's fit reads: the README's beam, somewhat softer, with noise."""
    mesh = jf.mesh.box((0.10, 0.03, 0.03), cells=(6, 2, 2), tets_per_cell=12)
    beam = jf.SoftBody(mesh, young=2e5, poisson=0.4, density=1070.0, damping=3e-3, fixed="x-")
    model, params, state = jf.build(jf.Scene([beam]))
    markers = attach(model, {"top": (0.1, 0.015, 0.03), "side": (0.1, 0.03, 0.015)})
    states, _ = jf.rollout(model, params, state, 1e-2, 20)
    still = np.tile(marker_positions(markers, state.positions), (10, 1, 1))
    places = np.concatenate([still, marker_positions(markers, states.positions)])
    places += 3e-5 * np.random.default_rng(0).normal(size=places.shape)
    write_recording(path, jf.Recording(1e-2 * np.arange(len(places)), places, markers.names))


@pytest.mark.slow
def test_the_code_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_recording(tmp_path / "recording.csv")
    names: dict = {}
    for number, block in enumerate(blocks("python"), 1):
        exec(compile(block, f"README.md, Python block {number}", "exec"), names)
    assert names["heights"].shape == (64,) and not names["infos"].status.any()
    values = names["result"].values
    assert values["young"] == pytest.approx(2e5, rel=0.02) and values["damping"] == pytest.approx(3e-3, rel=0.1)


def test_the_files_load(tmp_path):
    (tmp_path / "recording.csv").write_text(blocks("csv")[0])
    for name, block in files().items():
        (tmp_path / name).write_text(block)
    assert set(files()) == {"beam.toml", "fit.toml"}
    scene, fit = load_scene(tmp_path / "beam.toml"), load_fit(tmp_path / "fit.toml")
    model, params, _ = scene.build()
    assert scene.steps == 100 and len(params.loads) == 1
    recording = read_recording(fit.recording)
    assert recording.seen.sum() == 3 and attach(model, fit.places).names == recording.names


def test_every_toml_block_is_toml():
    for block in blocks("toml"):
        tomllib.loads(block)


def test_the_commands_exist():
    words = [shlex.split(line) for line in re.findall(r"`jaxfem (\w[^`]*)`", TEXT)]
    assert len(words) >= 3
    for each in words:
        parser().parse_args(each)


def test_the_tree_exists():
    tree = TEXT[TEXT.index("## Layout") :]
    inside = [
        name for line in re.findall(r"^      (\S.*)$", tree, re.MULTILINE) for name in line.split("   ")[0].split()
    ]
    assert len(inside) > 15
    for name in inside:
        assert (ROOT / "jaxfem" / name).exists(), name
    for name in ("examples", "notebooks", "tests"):
        assert f"{name}/" in tree and (ROOT / name).is_dir()
