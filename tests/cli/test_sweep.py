"""`jaxfem sweep`: killed and resumed with nothing lost or repeated; two processes give what one gives."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.cli import sweep
from jaxfem.cli.main import main
from jaxfem.io import load_scene, sweep_files
from jaxfem.solvers import Status
from jaxfem.sweeping.shards import read_manifest, read_shard, shard_path, write_shard

SCENE = """
[time]
step = 0.005
steps = 40
save_every = 20
[[body]]
name = "beam"
mesh = { box = [0.2, 0.1, 0.1], cells = [2, 1, 1] }
young = 1e5
poisson = 0.3
density = 1000.0
fixed = "x-"
"""
SWEEP = """
scene = "scene.toml"
[sweep]
kind = "random"
count = 75
seed = 4
width = 2
engine = "loop"
[values]
young = [1e5, 1e6, "log"]
"gravity[2]" = [-20, 20]
[outputs]
tip = { kind = "point", point = [0.2, 0.05, 0.05] }
top = { kind = "energies", take = "max" }
path = { kind = "positions", take = "all" }
[output]
plots = false
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)

    def written(text=SWEEP):
        (tmp_path / "sweep.toml").write_text(text)
        return tmp_path / "sweep.toml"

    return written


def shards(folder):
    return {path.name: path for path in (folder / "shards").glob("shard_*.npz")}


@pytest.mark.slow
def test_a_killed_sweep_goes_on_and_processes_do_not_matter(files, tmp_path, capsys):
    """Killed by SIGKILL, workers and all, when some shards are there; every file is the same to the bit."""
    path, one, two = files(), tmp_path / "one", tmp_path / "two"
    assert main(["sweep", str(path), "--out", str(one), "--processes", "1"]) == 0
    words = [sys.executable, "-m", "jaxfem", "sweep", str(path), "--out", str(two), "--processes", "2"]
    process = subprocess.Popen(words, start_new_session=True, stdout=subprocess.DEVNULL)
    while len(shards(two)) < 5:
        assert process.poll() is None, "it ended before it could be killed"
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = {name: each.stat().st_mtime_ns for name, each in shards(two).items()}
    assert 5 <= len(before) < 38
    (two / "shards" / "shard_000020.npz.1.part").write_bytes(b"half")
    assert main(["sweep", str(path), "--out", str(two), "--processes", "2"]) == 0
    assert f"{38 - len(before)} of them computed now" in capsys.readouterr().out
    after = shards(two)
    assert len(after) == 38 and all(after[name].stat().st_mtime_ns == time for name, time in before.items())
    for name, each in shards(one).items():
        assert each.read_bytes() == after[name].read_bytes()
    assert (one / "results.csv").read_bytes() == (two / "results.csv").read_bytes()
    rows = np.genfromtxt(two / "results.csv", delimiter=",", names=True)
    assert rows["variant"].tolist() == list(range(75)) and not rows["status"].any()
    _is_a_rollout(tmp_path, two, rows, 7)
    shard = shard_path(two, 3)
    kept = shard.read_bytes()
    shard.unlink()  # and again: the same bits
    assert main(["sweep", str(path), "--out", str(two)]) == 0
    assert shard.read_bytes() == kept


def _is_a_rollout(tmp_path, folder, rows, variant):
    """A row of the table and of the arrays is what a rollout gives; the shard says by what it was made."""
    model, params, state = load_scene(tmp_path / "scene.toml").build()
    own = params.replace(young=rows["young"][variant], gravity=params.gravity.at[2].set(rows["gravity2"][variant]))
    states, _ = jf.rollout(model, own, state, 0.005, 40, every=20)
    np.testing.assert_allclose(np.load(folder / "arrays" / "path.npy")[variant], states.positions, atol=1e-8)
    outputs, _, about = read_shard(folder, read_manifest(folder), variant // 2)
    assert outputs["tip"].shape == (2, 3) and about["made_by"]["jaxfem"] == jf.__version__
    assert {"jaxlib", "XLA_FLAGS", "processor", "precision"} <= set(about["made_by"])
    assert json.loads((folder / "manifest.json").read_text())["seed"] == 4


def test_files_of_another_sweep_are_not_mixed(files, tmp_path, capsys, monkeypatch):
    path = files()
    monkeypatch.setattr(sweep, "_watched", lambda *_: "stopped here")
    assert main(["sweep", str(path)]) == 3 and "stopped here" in capsys.readouterr().err
    assert main(["sweep", str(files(SWEEP.replace("seed = 4", "seed = 5")))]) == 2
    said = capsys.readouterr().err
    assert "of another sweep" in said and "--force" in said
    assert main(["sweep", str(path), "--force"]) == 3


def test_a_sweep_of_which_every_variant_fails_says_so(files, capsys, monkeypatch):
    """And of which some do not; the shards stand in for a computation."""
    bad = 75

    def made(source, folder, manifest, processes):
        for number in range(manifest.shards):
            own = manifest.members(number)
            told = {name: np.zeros(len(own), int) for name in ("iterations", "residual", "inverted")}
            told["status"] = np.where(own < bad, int(Status.ITERATION_LIMIT), 0)
            write_shard(shard_path(folder, number), manifest, number, {"tip": own.astype(float)}, told)
        return ""

    monkeypatch.setattr(sweep, "_watched", made)
    path = str(files())
    assert main(["sweep", path]) == 3
    said = capsys.readouterr()
    assert "no variant converged" in said.err and "75: " in said.out and "results.csv" in said.out
    bad = 74
    assert main(["sweep", path, "--force"]) == 0 and not capsys.readouterr().err


@pytest.mark.parametrize(("key", "module"), [('table = "parquet"', "pyarrow"), ('arrays = "zarr"', "zarr")])
def test_a_package_that_is_missing_is_told_before_anything_is_computed(files, capsys, monkeypatch, key, module):
    monkeypatch.setitem(sys.modules, module, None)
    path = files(SWEEP.replace("[output]", f"[output]\n{key}"))
    assert main(["sweep", str(path)]) == 2 and module in capsys.readouterr().err
    assert not (path.parent / "sweep_results").exists()


def test_the_template_holds_every_key_and_can_be_run(tmp_path, monkeypatch):
    """Commented keys too, once they are no comments any more; in place of computing, the plan is looked at."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scene"]) == 0 == main(["new", "sweep"])
    text = (tmp_path / "sweep.toml").read_text()
    known = (*sweep_files.SWEEP_KEYS, *sweep_files.OUTPUT_KEYS, *sweep_files.TOP_KEYS, *sweeping.OUTPUTS.words())
    assert all(word in text for word in known)
    file = sweep_files.load_sweep("sweep.toml")
    made = sweep.prepared(file, file.engine, file.width)
    assert made.count == 8 and made.chunks == 1 and set(made.variants) == {"young", "gravity[2]"}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "random"', 'kind = "randum"', "did you mean 'random'"),
        ("young = ", "yuong = ", "did you mean 'young'"),
        ('[1e5, 1e6, "log"]', "[1e6, 1e5]", 'the range of "young"'),
        ("count = 75", "", "missing key 'count'"),
        ("point = [0.2, 0.05, 0.05]", "point = [0.5, 0, 0]", "outside the bodies"),
        ('take = "max"', 'take = "most"', "known are all, last, max"),
        ('kind = "energies"', 'kind = "energy"', "did you mean 'energies'"),
        ('engine = "loop"', 'engine = "loops"', "did you mean 'loop'"),
        ("plots", "plot", "did you mean 'plots'"),
        ('kind = "random"', 'kind = "grid"', "'count' in [sweep] has no use with kind = \"grid\""),
        ("seed = 4", 'table = "values.csv"', "'table' in [sweep] has no use"),
        ('kind = "random"\ncount = 75', 'kind = "table"\ntable = "values.csv"', "[values] has no use"),
    ],
)
def test_mistakes(files, capsys, old, new, message):
    assert main(["sweep", str(files(SWEEP.replace(old, new)))]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_indices_of_a_file(files, tmp_path, capsys):
    """kind = "sobol" writes indices, a row for each output and variable; its count is a power of 2."""
    pytest.importorskip("SALib")
    text = SWEEP.replace('"random"', '"sobol"').replace("count = 75", "count = 4").replace("width = 2", "width = 16")
    assert main(["sweep", str(files(text)), "--out", str(tmp_path / "out"), "--processes", "1"]) == 0
    rows = (tmp_path / "out" / "indices.csv").read_text().splitlines()
    assert rows[0] == "output,variable,first,first_bar,total,total_bar"
    assert [row.split(",")[1] for row in rows[1:3]] == ["young", "gravity[2]"]
    assert "indices.csv" in capsys.readouterr().out and rows[1].startswith("tip[0],young,")
    assert np.isfinite([[float(cell) for cell in row.split(",")[2:]] for row in rows[1:]]).all()
    wrong = text.replace("count = 4", "count = 5")
    assert main(["sweep", str(files(wrong)), "--out", str(tmp_path / "other")]) == 2
    assert "power of 2" in capsys.readouterr().err
