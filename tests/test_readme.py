"""What the README and docs/ show is true: their code runs, files load, commands and folders exist."""

import importlib.util
import pathlib
import re
import shlex
import subprocess
import sys
import tomllib

import jax
import numpy as np
import pytest
from test_layers import LEVEL

import jaxfem as jf
from jaxfem.cli import programs
from jaxfem.cli.main import parser
from jaxfem.fitting import attach, marker_positions, read_recording, write_recording
from jaxfem.io import load_scene
from jaxfem.io.fit_files import load_fit

ROOT = pathlib.Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted((ROOT / "docs").rglob("*.md"))
START, SCENES = ((ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("start.md", "guide/scenes.md"))
pages = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
EXTRA_KEYS = ("jax_compilation_cache_dir", "jax_enable_compilation_cache", "jax_enable_x64")
EXTRA_KEYS += ("jax_persistent_cache_min_compile_time_secs", "jax_persistent_cache_min_entry_size_bytes")


def blocks(language: str, text: str = TEXT) -> list[str]:
    """The fenced blocks of one language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


@pytest.fixture
def settings():
    """JAX's settings that pages may change, put back at the end."""
    before = {name: getattr(jax.config, name) for name in EXTRA_KEYS}
    yield
    for name, value in before.items():
        jax.config.update(name, value)


def files() -> dict[str, str]:
    """TOML blocks by the file name in their first line; those without one are parts of a file."""
    named = {}
    for block in (*blocks("toml", START), *blocks("toml", SCENES)):
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
def test_the_code_runs():
    names: dict = {}
    (block,) = blocks("python")
    assert len(block.splitlines()) <= 18
    exec(compile(block, "README.md", "exec"), names)
    assert names["heights"].shape == (64,) and bool((names["heights"][1:] > names["heights"][:-1]).all())


def test_the_readme_is_one_screen():
    """What it is, a picture, two commands, some lines of Python, links."""
    assert len(TEXT.splitlines()) < 60
    for link in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        assert (ROOT / link).is_file(), link


def test_the_files_load(tmp_path):
    (tmp_path / "recording.csv").write_text(blocks("csv", START)[0])
    for name, block in files().items():
        (tmp_path / name).write_text(block)
    assert set(files()) == {"beam.toml", "fit.toml"}
    scene, fit = load_scene(tmp_path / "beam.toml"), load_fit(tmp_path / "fit.toml")
    model, params, _ = scene.build()
    assert scene.steps == 100 and len(params.loads) == 1
    recording = read_recording(fit.recording)
    assert recording.seen.sum() == 3 and attach(model, fit.places).names == recording.names


@pytest.mark.slow
@pages
def test_the_code_of_a_page_runs(page, settings, tmp_path, monkeypatch):
    """All blocks of a page in order, as one program, in an empty folder and without the user's own."""
    monkeypatch.chdir(tmp_path)
    for name in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(name, str(tmp_path))
    if "recording.csv" in page.read_text(encoding="utf-8"):
        make_recording(tmp_path / "recording.csv")
    names: dict = {"__name__": f"docs.{page.stem}"}
    for number, block in enumerate(blocks("python", page.read_text(encoding="utf-8")), 1):
        exec(compile(block, f"docs/{page.name}, Python block {number}", "exec"), names)
    if page.stem == "start":
        values = names["result"].values
        assert names["heights"].shape == (64,)
        assert values["young"] == pytest.approx(2e5, rel=0.02) and values["damping"] == pytest.approx(3e-3, rel=0.1)


def test_links_between_pages_lead_somewhere():
    """Those to pages that are made when the site is built aside."""
    made = {"scene_files", "fit_files", "command_line", "python"}
    for page in PAGES:
        for link, _, anchor in re.findall(r"\]\(([^)#:]+\.(?:md|png))(#([\w-]+))?\)", page.read_text(encoding="utf-8")):
            target = (page.parent / link).resolve()
            if target.parent.name == "reference":
                assert target.stem in made
                continue
            assert target.is_file(), (page.name, link)
            if anchor:
                heads = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
                assert anchor in {re.sub(r"[^\w-]", "", head.lower().replace(" ", "-")) for head in heads}, link


def test_the_site_holds_every_page():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in PAGES:
        assert f" {page.relative_to(ROOT / 'docs').as_posix()}" in nav, page


@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="needs mkdocs: pip install 'jaxfem[docs]'")
def test_the_site_builds_without_a_warning(tmp_path):
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    ran = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    python = (tmp_path / "reference" / "python" / "index.html").read_text(encoding="utf-8")
    for name in jf.__all__:
        assert name.startswith("_") or f"jaxfem.{name}" in python, name


def test_every_toml_block_is_toml():
    for text in (TEXT, *(page.read_text(encoding="utf-8") for page in PAGES)):
        for block in blocks("toml", text):
            tomllib.loads(block)


@pages
def test_a_page_fences_only_what_is_checked(page):
    """A block in a language that no test knows would not be looked at."""
    found = set(re.findall(r"^```(\w*)$", page.read_text(encoding="utf-8"), re.MULTILINE)) - {""}
    assert found <= {"python", "toml", "text", "sh", "csv"}


def test_the_commands_exist():
    assert len(commands(TEXT)) >= 3
    for text in (TEXT, *(page.read_text(encoding="utf-8") for page in PAGES)):
        for each in commands(text):
            if len(each) > 1:
                parser().parse_args(each)
                continue
            with pytest.raises(SystemExit) as stop:  # a command that is only spoken of
                parser().parse_args([*each, "--help"])
            assert stop.value.code == 0


def commands(text: str) -> list[list[str]]:
    """Words of each `jaxfem ...` in a text, those with dots for what is left open aside."""
    found = re.findall(r"`jaxfem ((?:--|\w)[^`]*)`", text)
    return [shlex.split(line) for line in found if "..." not in line]


def test_what_a_page_says_of_the_cache_is_what_the_command_does():
    page = (ROOT / "docs" / "compile_cache.md").read_text(encoding="utf-8")
    assert f"`{programs.SWITCH}=off`" in page and "--no-cache" in page and f"{programs.LARGEST >> 30} GB" in page
    block = blocks("python", page)[0]
    assert re.findall(r'"(jax_\w+)"', block) == list(EXTRA_KEYS[:1] + EXTRA_KEYS[3:])


def test_the_architecture_page_names_every_layer():
    table = [line for line in (ROOT / "docs" / "architecture.md").read_text().splitlines() if line.startswith("| `")]
    named = [re.findall(r"`(\w+)`", line.split("|")[1]) for line in table]
    order = [LEVEL[name] for names in named for name in names]
    assert order == sorted(order) and {name for names in named for name in names} >= set(LEVEL) - {
        "motion",  # beside what they belong to
        "loads",
        "energies",
    }


def test_the_tree_exists():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    tree = text[text.index("## Layout") :]
    inside = [name for line in re.findall(r"^  (\S.*)$", tree, re.MULTILINE) for name in line.split("   ")[0].split()]
    assert len(inside) > 15
    for name in inside:
        assert (ROOT / "jaxfem" / name).exists(), name
    for name in ("examples", "notebooks", "tests"):
        assert f"{name}/" in tree and (ROOT / name).is_dir()
