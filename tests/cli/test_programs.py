"""Compiled programs kept between runs of the command line: where, when not, and that a second run uses them."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import pytest

from jaxfem.cli import bench, programs
from jaxfem.cli.main import _show_warnings_briefly, main, parser

SETTINGS = (
    "jax_enable_compilation_cache",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
SCENE = """
[time]
step = 0.01
steps = 2
[[rigid]]
name = "ball"
shape = { sphere = 0.1 }
mass = 1.0
[output]
folder = "out"
"""


def settings():
    return {name: getattr(jax.config, name) for name in SETTINGS}


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """JAX without a cache of its own, and the user's folders in `tmp_path`; JAX's settings are put back."""
    before = settings()
    jax.config.update("jax_enable_compilation_cache", True)
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.delenv(programs.SWITCH, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    yield settings()
    for name, value in before.items():
        jax.config.update(name, value)


def test_all_programs_are_kept_in_the_users_folder(bare, tmp_path):
    assert programs.keep_programs() == tmp_path / "jaxfem" / "programs"
    assert (tmp_path / "jaxfem" / "programs").is_dir()
    assert list(settings().values()) == [True, str(tmp_path / "jaxfem" / "programs"), 0.0, -1]


@pytest.mark.parametrize(("wanted", "word"), [(False, ""), (True, "off"), (True, "OFF"), (True, "0")])
def test_switched_off(bare, monkeypatch, tmp_path, wanted, word):
    monkeypatch.setenv(programs.SWITCH, word)
    assert programs.keep_programs(wanted) is None
    assert settings() == bare | {"jax_enable_compilation_cache": False} and not list(tmp_path.iterdir())


def test_a_folder_of_ones_own(bare, monkeypatch, tmp_path):
    monkeypatch.setenv(programs.SWITCH, str(tmp_path / "mine"))
    assert programs.keep_programs() == tmp_path / "mine" == Path(jax.config.jax_compilation_cache_dir)


def test_what_the_user_set_up_for_jax_stays(bare, tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "jax"))
    assert programs.keep_programs() is None
    assert settings() == bare | {"jax_compilation_cache_dir": str(tmp_path / "jax")}
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_told_once_and_done_without(bare, monkeypatch, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(programs.SWITCH, str(tmp_path / "file" / "below"))
    assert programs.keep_programs() is None and settings() == bare
    said = capsys.readouterr().err
    assert said.startswith("jaxfem: warning: compiled programs are not kept: ") and said.count("\n") == 1
    assert "JAXFEM_CACHE=off" in said and str(tmp_path / "file" / "below") in said


@pytest.mark.parametrize(
    ("platform", "environ", "expected"),
    [
        ("linux", {}, "HOME/.cache/jaxfem"),
        ("linux", {"XDG_CACHE_HOME": "/caches"}, "/caches/jaxfem"),
        ("linux", {"XDG_CACHE_HOME": "relative"}, "HOME/.cache/jaxfem"),
        ("darwin", {"XDG_CACHE_HOME": "/caches"}, "HOME/Library/Caches/jaxfem"),
        ("win32", {"LOCALAPPDATA": "/users/me/local"}, "/users/me/local/jaxfem/Cache"),
        ("win32", {}, "HOME/AppData/Local/jaxfem/Cache"),
    ],
)
def test_where_each_platform_keeps_them(platform, environ, expected):
    assert programs.cache_folder(environ, platform) == Path(expected.replace("HOME", str(Path.home())))


def test_those_used_longest_ago_go_first(tmp_path):
    for age, name in enumerate(["new", "old", "oldest"]):
        path = tmp_path / f"{name}-cache"
        path.write_bytes(bytes(100))
        os.utime(path, (1e9 - age, 1e9 - age))
    (tmp_path / "else").write_bytes(bytes(1000))  # not a program: neither counted nor touched
    os.utime(tmp_path / "old-cache", (2e9, 1e9 - 1))  # written long ago, read since
    programs.trim(tmp_path, 300)
    assert len(list(tmp_path.iterdir())) == 4
    programs.trim(tmp_path, 299)
    assert not (tmp_path / "oldest-cache").exists() and (tmp_path / "new-cache").exists()
    programs.trim(tmp_path, 100)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["else", "old-cache"]


def test_a_callers_process_is_left_alone(bare, capsys):
    assert main(["mesh", "info", "none.msh"]) == 2 and settings() == bare
    assert parser().parse_args(["--no-cache", "mesh", "info", "x"]).no_cache


@pytest.mark.parametrize(("words", "on"), [(["mesh", "info", "none.msh"], True), (["bench"], False)])
def test_the_processs_own_command_line_keeps_them_unless_it_times_compiling(bare, monkeypatch, words, on):
    monkeypatch.setattr(sys, "argv", ["jaxfem", *words])
    monkeypatch.setattr(bench, "measure", lambda *_: (_ for _ in ()).throw(OSError("measured")))
    assert main() == 2  # the mesh is missing; the benchmark is cut short
    assert jax.config.jax_enable_compilation_cache is on and (jax.config.jax_compilation_cache_dir is not None) is on


def test_a_second_run_compiles_nothing(tmp_path):
    """The process itself, `python -m jaxfem`, with JAX telling what it finds."""
    (tmp_path / "run.toml").write_text(SCENE)
    names = ("JAX_COMPILATION_CACHE_DIR", "JAX_ENABLE_COMPILATION_CACHE", programs.SWITCH)
    environ = {name: value for name, value in os.environ.items() if name not in names}
    environ |= {"JAXFEM_CACHE": str(tmp_path / "kept"), "JAX_LOG_COMPILES": "1"}
    command = [sys.executable, "-m", "jaxfem", "simulate", str(tmp_path / "run.toml"), "--no-plots", "--force"]

    def run(*options):
        done = subprocess.run([*command, *options], capture_output=True, text=True, env=environ, check=True)
        return done.stderr.count("cache hit for 'jit__frames'"), (tmp_path / "out" / "rigid.csv").read_text()

    hits, poses = run()
    kept = {path.name for path in (tmp_path / "kept").iterdir()}
    assert hits == 0 and any(name.startswith("jit__frames") for name in kept)
    assert run() == (1, poses)
    assert {path.name for path in (tmp_path / "kept").iterdir()} == kept
    assert run("--no-cache") == (0, poses)


def test_programs_that_cannot_be_written_are_told_once(capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        _show_warnings_briefly()
        for name in ("jit_step", "jit_rollout"):
            warnings.warn(f"Error writing persistent compilation cache entry for '{name}': disk full", stacklevel=1)
    said = capsys.readouterr().err
    assert said.count("jaxfem: warning: Error writing") == 1 == said.count("\n") and "going on without" in said
