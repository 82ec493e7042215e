"""`jaxfem simulate` in process: files, exit codes, and what is said when a run is interrupted or a step fails."""

import csv
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli import messages, progress, running, simulate
from jaxfem.cli.main import main
from jaxfem.io import load_scene, read_frames

SCENE = """
[time]
step = 0.01
steps = 6
save_every = {every}
[solver]
max_iterations = {iterations}
[[body]]
name = "beam"
mesh = {{ box = [0.2, 0.1, 0.1], cells = [2, 1, 1] }}
young = {young}
poisson = 0.3
density = 1000.0
fixed = "x-"
[output]
folder = "out"
points = {{ tip = [0.2, 0.05, 0.05] }}
"""


@pytest.fixture
def scene(tmp_path):
    def written(more="", every=1, iterations=20_000, young=1e5):
        path = tmp_path / "run.toml"
        path.write_text(SCENE.format(every=every, iterations=iterations, young=young) + more)
        return path

    return written


def simulated(path, *options):
    again = () if {"--resume", "--no-force"} & set(options) else ("--force",)
    return main(["simulate", str(path), *again, *(option for option in options if option != "--no-force")])


def rows(path):
    with open(path) as file:
        return list(csv.reader(file))


@pytest.fixture
def chunks(monkeypatch):
    """Replace what follows the k-th chunk, of one frame: `chunks(k, change)` gives its (states, infos) to `change`."""

    def install(number, change):
        calls = []
        frames = running.frames

        def patched(*args, **options):
            calls.append(1)
            made = frames(*args, **options)
            return (*change(*made[:2]), made[2]) if len(calls) == number else made

        monkeypatch.setattr(running, "frames", patched)
        monkeypatch.setattr(running, "MOST", 1)

    return install


def test_complete_run(scene, tmp_path, capsys):
    path = scene()
    assert simulated(path) == 0
    said = capsys.readouterr()
    assert said.err == ""  # no bar where there is no terminal
    assert "run.toml: 6 of 6 steps, to t = 0.06 s" in said.out and "ms a step" in said.out
    assert "wrote 7 frames and run.pvd, energies.csv, points.csv, energies.png, shapes.png, points.png" in said.out
    out = tmp_path / "out"
    frames = read_frames(out / "run.pvd")
    model, params, state = load_scene(path).build()
    states, _ = jf.rollout(model, params, state, 0.01, 1)
    np.testing.assert_allclose(frames[1].positions, states.positions[0], atol=1e-12)
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(7) * 0.01, atol=1e-9)
    assert frames[6].displacement[:, 2].min() < -1e-4
    assert len(rows(out / "energies.csv")) == 8 == len(rows(out / "points.csv"))
    for name in ("energies", "shapes", "points"):
        assert (out / f"{name}.png").stat().st_size > 5000


def test_options(scene, tmp_path, capsys):
    assert simulated(scene(), "--steps", "2", "--out", str(tmp_path / "else"), "--no-plots") == 0
    assert "2 of 2 steps" in capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "else").iterdir()) == [
        "energies.csv",
        "frames",
        "points.csv",
        "run.pvd",
        "run.state.npz",
    ]
    with pytest.raises(SystemExit) as stop:
        simulated(scene(), "--steps", "0")
    assert stop.value.code == 2 and "'0' is not a whole number of at least 1" in capsys.readouterr().err


def test_results_of_two_scenes_do_not_share_a_folder(scene, tmp_path, capsys):
    """Their tables would: refused, also with --force. Pictures of an earlier run go where none are drawn."""
    path, out = scene(), tmp_path / "out"
    assert simulated(path, "--steps", "2") == 0 and (out / "shapes.png").is_file()
    other = path.with_name("other.toml")
    other.write_text(path.read_text())
    for force in ((), ("--force",)):
        assert simulated(other, "--out", str(out), *force) == 2
        assert "results of another scene, run.pvd" in capsys.readouterr().err
    assert simulated(path, "--steps", "2", "--force", "--no-plots") == 0
    assert not list(out.glob("*.png"))


def test_interruption(scene, tmp_path, capsys, chunks):
    def interrupt(*_):
        raise KeyboardInterrupt

    chunks(4, interrupt)
    assert simulated(scene()) == 130
    said = capsys.readouterr()
    assert "jaxfem: error: interrupted after step 3 of 6 (t = 0.03 s)" in said.err
    assert len(read_frames(tmp_path / "out" / "run.pvd")) == 4 == len(rows(tmp_path / "out" / "energies.csv")) - 1
    assert (tmp_path / "out" / "shapes.png").is_file() and "3 of 6 steps" in said.out


def test_solve_that_does_not_converge(scene, tmp_path, capsys):
    assert simulated(scene(iterations=1), "--no-plots") == 3
    said = capsys.readouterr().err
    assert "jaxfem: error: step 1 of 6 (t = 0.01 s) failed: iteration limit" in said
    assert 'body "beam" is the fastest' in said
    assert "iteration limit" in said and "raise max_iterations" in said
    assert len(read_frames(tmp_path / "out" / "run.pvd")) == 1


def test_numbers_that_overflow(scene, tmp_path, capsys):
    path = scene()
    path.write_text("gravity = [0, 0, -1e300]\n" + path.read_text())
    assert simulated(path) == 3
    said = capsys.readouterr().err
    assert "step 1 of 6 (t = 0.01 s) failed" in said and "take a smaller time step" in said
    assert (tmp_path / "out" / "energies.png").is_file()


def test_body_that_is_lost(scene, tmp_path, capsys, chunks):
    """NaN at one node of the second body, at the third step."""

    def spoil(states, infos):
        return states.replace(velocities=states.velocities.at[:, -1].set(jnp.nan)), infos

    second = SCENE[SCENE.index("[[body]]") : SCENE.index("[output]")].format(young=1e5).replace("beam", "block")
    chunks(3, spoil)
    assert simulated(scene("\n" + second), "--no-plots") == 3
    said = capsys.readouterr()
    assert "step 3 of 6 (t = 0.03 s) failed: not finite" in said.err
    assert 'body "block" is not finite any more: 1 of its 12 nodes' in said.err
    assert 'body "beam" is not finite' not in said.err
    assert "2 of 6 steps" in said.out and len(read_frames(tmp_path / "out" / "run.pvd")) == 3


def test_the_step_of_a_chunk_that_failed(scene, tmp_path, capsys, chunks):
    """A chunk of three ends at its second step."""
    chunks(2, lambda states, infos: (states.replace(time=states.time - 0.01), infos.replace(status=infos.status + 1)))
    assert simulated(scene(every=3), "--no-plots") == 3
    said = capsys.readouterr()
    assert "step 5 of 6 (t = 0.05 s) failed" in said.err and "4 of 6 steps" in said.out
    assert len(read_frames(tmp_path / "out" / "run.pvd")) == 2


def test_a_step_that_fails_is_taken_in_halves(scene, tmp_path, capsys):
    """A bound on iterations that the whole step exceeds and its halves do not."""
    path = scene()
    model, params, state = load_scene(path).build()
    whole, half = (int(jf.step(model, params, state, dt)[1].iterations) for dt in (1e-3, 5e-4))
    assert half < whole
    short = scene(iterations=whole - 1).read_text().replace("step = 0.01", "step = 0.001")
    path.write_text(short)
    assert simulated(path, "--no-plots", "--steps", "1") == 3
    assert "step 1 of 1 (t = 0.001 s) failed: iteration limit" in capsys.readouterr().err
    path.write_text(short.replace("[time]", "[time]\nhalvings = 2"))
    assert simulated(path, "--no-plots", "--steps", "1") == 0
    path.write_text(short.replace("[time]", "[time]\nhalvings = 2").replace(f"= {whole - 1}", "= 1"))
    assert simulated(path, "--no-plots", "--steps", "1") == 3
    assert "failed, also in steps of 0.00025 s: iteration limit" in capsys.readouterr().err


def test_elements_inside_out(scene, capsys, chunks):
    def turned(states, infos):
        mirrored = states.positions * jnp.array([-1.0, 1.0, 1.0])
        return states.replace(positions=mirrored), infos.replace(inverted=infos.inverted + 2)

    chunks(6, turned)
    assert simulated(scene(), "--no-plots") == 0
    said = capsys.readouterr().err
    assert said.count("jaxfem: warning:") == 1
    assert '2 elements are turned inside out in "beam" between steps 5 and 6: take a smaller time step' in said


def test_accuracy_warning_is_one_line(scene, capsys):
    path = scene()
    path.write_text(path.read_text().replace("poisson = 0.3", "poisson = 0.48"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # not even seen by the caller's filters
        assert simulated(path, "--steps", "1", "--no-plots") == 0
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and said[0].startswith('jaxfem: warning: "beam" has Poisson\'s ratio 0.48')


def test_without_matplotlib(scene, capsys, monkeypatch):
    def missing():
        raise simulate.PlotError("plots need matplotlib: pip install 'jaxfem[cli]'")

    monkeypatch.setattr(simulate, "require_matplotlib", missing)
    assert simulated(scene(), "--steps", "1") == 0
    said = capsys.readouterr()
    assert "jaxfem: warning: plots need matplotlib" in said.err and "png" not in said.out


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("young", "yuong", "unknown key 'yuong' in [[body]] 1 \"beam\": did you mean 'young'?"),
        ("poisson = 0.3", "poisson = 0.5", 'poisson of "beam" is 0.5'),
        ("step = 0.01", "step = -1", "'step' in [time] is -1"),
        ("[time]", "[time]\nhalvings = 11", "'halvings' in [time] is 11: it must be a whole number from 1 to 10"),
        ("mesh = ", 'mesh = { file = "no.msh" } # ', "no mesh file"),
        ("[0.2, 0.05", "[0.5, 0.05", 'the tracked point "tip" at [0.5, 0.05, 0.05] lies 0.3 m outside'),
        ('"x-"', '"left"', 'no node group "left"'),
        ("[time]", "[time", "not valid TOML"),
        ('folder = "out"', 'folder = "run.toml"', "run.toml"),
    ],
)
def test_mistakes(scene, capsys, old, new, message):
    path = scene()
    path.write_text(path.read_text().replace(old, new))
    assert simulated(path) == 2
    said = capsys.readouterr().err
    assert said.startswith("jaxfem: error: ") and message in said and said.count("\n") == 1


def test_missing_scene_and_debug(tmp_path, capsys):
    assert simulated(tmp_path / "none.toml") == 2
    assert "jaxfem: error: no scene file" in capsys.readouterr().err
    with pytest.raises(FileNotFoundError):
        simulated(tmp_path / "none.toml", "--debug")


def test_timing_leaves_the_compiling_chunks_out():
    run = running.Run(None, None, None, 0.1, 25, 10, chunks=[(10, 3.0), (10, 1.0), (5, 0.5)])
    compiling, each = run.timing()
    assert each == pytest.approx(0.1) and compiling == pytest.approx(3.0 - 1.0)
    assert running.Run(None, None, None, 0.1, 5, 5, chunks=[(5, 2.0)]).timing() == (2.0, 0.0)


@pytest.mark.parametrize("with_tqdm", [True, False])
def test_progress(capsys, monkeypatch, with_tqdm):
    if not with_tqdm:
        monkeypatch.setitem(__import__("sys").modules, "tqdm", None)
    with progress.Progress(4, shown=True) as bar:
        bar.advance(1, "t = 0.1 s")
        bar.clear()
        messages.warning("careful")
        bar.advance(3, "t = 0.4 s")
    said = capsys.readouterr().err
    assert "jaxfem: warning: careful" in said and (" 0/4 " if with_tqdm else "t = 0.4 s") in said
    with progress.Progress(4) as bar:  # not a terminal
        bar.advance(4)
        bar.clear()
    assert capsys.readouterr().err == ""


def test_double_precision_is_on(scene):
    assert simulated(scene(), "--steps", "1", "--no-plots") == 0
    assert jax.config.jax_enable_x64
