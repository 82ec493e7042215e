"""Variants that cost about the same go through chunks together, and results come in the caller's order."""

import csv
import json

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import beam

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.cli.main import main
from jaxfem.sweeping.derivatives import UNSOLVED
from jaxfem.sweeping.order import STRETCH, sorted_by, stretches

DT, STEPS = 5e-3, 10
YOUNG = np.array([3e5, 1e4, -1.0, 1e6, 1e5, 3e4, 2e4])
TIP = {"tip": lambda run: run.last.positions[-1, 2]}
OPTIONS = {"dt": DT, "steps": STEPS, "every": STEPS, "outputs": TIP, "engine": "lanes", "derivatives": ["young"]}


def test_dear_ones_first_in_stretches():
    """Each stretch is sorted by itself, holds a whole range of variants, and is as short as its outputs need."""
    rng = np.random.default_rng(0)
    costs = rng.normal(size=1000)
    costs[[3, 500]] = np.nan, np.inf
    for size, bytes_each in ((2, 8), (4, 10_000_000)):
        order = sorted_by(costs, size, bytes_each)
        assert sorted(order) == list(range(1000))
        ends = [min(at + size, 1000) for at in range(0, 1000, size)]
        found = stretches(order, ends)
        assert [each for stretch in found for each in stretch] == list(range(len(ends)))
        long = STRETCH if bytes_each == 8 else 2
        assert max(map(len, found)) == long
        for stretch in found:
            own = order[stretch.start * size : ends[stretch.stop - 1]]
            assert sorted(own) == list(range(own.min(), own.max() + 1))
            finite = costs[own][np.isfinite(costs[own])]
            assert (np.diff(finite) <= 0).all() and np.isfinite(costs[own][: len(finite)]).all()


@pytest.fixture(scope="module")
def scene():
    return beam((2, 1, 1))


def test_results_come_in_the_callers_order(scene):
    """Softest first, what cannot be last; each variant has what one after another gives it."""
    made = sweeping.Sweep(*scene, {"young": YOUNG}, width=2, **OPTIONS)
    assert [made.members(chunk).tolist() for chunk in range(made.chunks)] == [[1, 6], [5, 4], [0, 3], [2]]
    lanes, loop = (jf.sweep(*scene, {"young": YOUNG}, **{**OPTIONS, "engine": e}, width=2) for e in ("lanes", "loop"))
    assert lanes.status.tolist() == loop.status.tolist() and lanes.good.sum() == 6
    good = lanes.good
    np.testing.assert_allclose(lanes["tip"][good], loop["tip"][good], rtol=1e-6)
    slopes = [each.derivative("tip", "young")[good] for each in (lanes, loop)]
    np.testing.assert_allclose(*slopes, rtol=1e-5)
    whole = sweeping.Sweep(*scene, {"young": YOUNG}, width=7, **OPTIONS)
    assert whole.order is None  # one chunk: nothing to sort


def test_loads_and_speeds_cost_too(scene):
    """Of equal stiffness, what is pulled harder, or starts faster, is deformed further."""
    model, _, _ = scene
    kicks = np.arange(4.0)[[2, 0, 3, 1], None, None] * np.linspace(0, 1, model.nodes)[:, None] * np.ones((4, 1, 3))
    kicks *= np.asarray(model.free)[:, None]
    for variants in ({"gravity[2]": [-20.0, -1.0, -40.0, -10.0]}, {"state.velocities": kicks}):
        made = sweeping.Sweep(*scene, variants, width=1, **{**OPTIONS, "derivatives": ()})
        assert made.order.tolist() == [2, 0, 3, 1]


def test_a_derivative_that_is_none_is_no_success(scene):
    """Of the root of what is 0: the values are right, and the status says what is not."""
    outputs = {"root": lambda run: jnp.sqrt(jnp.abs(run.last.positions[0, 0]))}
    for engine in ("lanes", "loop"):
        made = jf.sweep(*scene, {"young": [1e5]}, **{**OPTIONS, "outputs": outputs, "engine": engine})
        assert made["root"].tolist() == [0.0] and made.status.tolist() == [UNSOLVED]
        assert "a derivative of an output is not finite" in str(made)


def test_columns_of_one_name_are_refused(scene):
    for name in ("status", "young", "variant"):
        with pytest.raises(jf.SweepError, match=f'two columns of the table are called "{name}"'):
            jf.sweep(*scene, {"young": [1e5]}, **{**OPTIONS, "outputs": {name: TIP["tip"]}})


SCENE = """
[time]
step = 0.005
steps = 10
save_every = 10
[[body]]
name = "beam"
mesh = { box = [0.1, 0.03, 0.03], cells = [2, 1, 1] }
young = 1e5
poisson = 0.4
density = 1070.0
damping = 2e-3
fixed = "x-"
"""
SWEEP = """
scene = "scene.toml"
[sweep]
kind = "grid"
engine = "lanes"
width = 2
[values]
young = [3e5, 1e4, -1.0, 1e6, 1e5, 3e4, 2e4]
[outputs]
"the end" = { kind = "point", point = [0.1, 0.015, 0.015] }
the_path = { kind = "positions", take = "all" }
"the path" = { kind = "positions", take = "all" }
[output]
plots = false
"""


def test_files_come_in_the_callers_order(tmp_path, capsys):
    """Shards hold variants as sorted, and say which; tables and arrays do not; a shard made again is the same file."""
    (tmp_path / "scene.toml").write_text(SCENE)
    path = tmp_path / "sweep.toml"
    path.write_text(SWEEP)
    assert main(["sweep", str(path), "--begin"]) == 0 == main(["sweep", str(path), "--worker", "0/1"])
    folder = tmp_path / "sweep_results"
    assert json.loads((folder / "manifest.json").read_text())["order"] == [1, 6, 5, 4, 0, 3, 2]
    assert main(["sweep", str(path)]) == 0
    with (folder / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["young"]) for row in rows] == YOUNG.tolist()
    assert [row["variant"] for row in rows] == list("0123456")
    good = np.array([row["status"] == "0" for row in rows])
    assert good.tolist() == (YOUNG > 0).tolist()
    ends = np.array([float(row["the end[2]"]) for row in rows])
    assert (np.argsort(ends[good]) == np.argsort(YOUNG[good])).all()  # the softest hangs lowest
    arrays = {each.stem: np.load(each) for each in (folder / "arrays").iterdir()}
    assert set(arrays) == {"the_path", "the_path_2"}
    deep = arrays["the_path"][:, -1, :, 2].min(1)
    assert (np.argsort(deep[good]) == np.argsort(YOUNG[good])).all()
    shard = folder / "shards" / "shard_000001.npz"
    kept = shard.read_bytes()
    shard.write_bytes(kept[: len(kept) // 2])
    capsys.readouterr()
    assert main(["sweep", str(path)]) == 2
    said = capsys.readouterr().err
    assert "shard_000001.npz cannot be read" in said and "remove it" in said
    shard.unlink()
    assert main(["sweep", str(path), "--worker", "0/1"]) == 0
    assert shard.read_bytes() == kept
    (folder / "manifest.json").write_text("{}")
    assert main(["sweep", str(path)]) == 2 and "--force" in capsys.readouterr().err
