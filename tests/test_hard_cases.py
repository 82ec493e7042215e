"""The quick half of benchmarks/hard_cases.py: every case is right or flagged by name. And the judging itself."""

import json
import math
import pathlib
import sys
import warnings

import jax
import numpy as np
import pytest

import jaxfem as jf

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1] / "benchmarks"))  # behind: both have a `scenes`

import hard_cases
from hard import page, running, worlds
from hard.case import CASES, Case, NotServed, Setting, Told, Wanted, judged

QUICK = [name for name, each in CASES.items() if each.quick]
LATER = {name for name in QUICK if CASES[name].group in ("momentum",) and "tumbling" in name}  # many steps


@pytest.fixture
def double():
    return Setting("condensed", "float64")


def marked(name):
    return pytest.param(name, marks=[pytest.mark.slow] if name in LATER else [])


@pytest.mark.parametrize("name", [marked(name) for name in QUICK])
def test_right_or_flagged_by_name(name):
    each = CASES[name]
    line = judged(each, hard_cases.settings(each, quick=True)[0])
    assert line["outcome"].split(":")[0] in ("right", "flagged"), line["outcome"]


def test_every_case_of_the_list_is_there():
    """Names of what the suite is asked for: none of them may be lost."""
    wanted = (
        "flattened;mirrored, seed 9;inside out;line;point;random;scaled 0.01;scaled 10;200 g and back;brick of 1 GPa"
    )
    wanted += (
        ";1 g links with 1 kg;1 g links with 100 kg;1 g links with 1000 kg;1000 kg on 1 g;E jumps by 1e6;sliver of 0.5 "
    )
    wanted += ";sliver of 0.05 ;nu 0.4999;dt 1 s;dt 1e-6 s;1e4 steps of spin;1e4 steps of tumbling;slope of;at 100 m/s"
    wanted += ";thin plate at 50 ;thin plate at 200 ;redundant;contradict;NaN in every;infinity in every;1 km;1e5 steps"
    wanted += ";half in the floor;motor;rope;friction 10;friction 1e6;restitution 1;g = 1e4;tiny element;one bad lane"
    for words in wanted.split(";"):
        assert any(words in name for name in CASES), words
    assert {route for each in CASES.values() for route in each.routes} >= {"condensed", "mprgp", "direct", "pgs"}
    assert len({(at.route, at.dtype) for each in CASES.values() for at in hard_cases.settings(each, False)}) > 6


@pytest.mark.parametrize(
    ("function", "outcome"),
    [
        (lambda at: Told([Wanted("x", 1.0, 1.0)]), "right"),
        (lambda at: Told([Wanted("x", 1.0, 1.0), Wanted("y", 2.0, 1.0)]), "SILENT: y 2 above 1"),
        (lambda at: Told([Wanted("x", math.nan, 1.0)]), "SILENT: x nan above 1"),
        (lambda at: Told([Wanted("x", 2.0, 1.0)], flags=["a word"]), "flagged: a word"),
        (
            lambda at: warnings.warn("biased", jf.AccuracyWarning, stacklevel=1) or Told([Wanted("x", 2, 1)]),
            "flagged: warned",
        ),
        (lambda at: jf.Scene([]), "flagged: refused: the scene holds no body"),
        (lambda at: 1 / 0, "crashed: ZeroDivisionError"),
    ],
)
def test_how_a_case_is_judged(double, function, outcome):
    line = judged(Case("one", "some", ("condensed",), False, False, function), double)
    assert line["outcome"].startswith(outcome)


def test_a_method_that_refuses_is_not_served():
    assert judged(CASES["flattened"], Setting("pgs", "float64"))["outcome"].startswith('not served: solver "pgs"')
    with pytest.raises(NotServed):
        worlds.free_cube(Setting("direct", "float64"))


def test_a_run_is_measured_as_it_is(double):
    """A cube that falls freely: no energy, no momentum lost; one that is pushed: both; one that is lost: flagged."""
    world = worlds.free_cube(double)
    params = world.params.replace(gravity=world.params.gravity.at[2].set(-9.81))
    run = running.roll(world, 1e-3, 20, None, params)
    assert abs(run.energy_growth) < 1e-2 and run.linear_drift < 1e-6 and run.status == 0 and not run.flags()
    assert running.recovery(world, run.end) < 1e-9
    pushed = jax.tree.map(np.array, run.end)
    pushed.velocities[:, 0] += 1.0
    other = running.Run(
        world, params, [*run.frames, pushed], run.infos, np.vstack([run.energies, run.energies[-1] + 1])
    )
    assert other.linear_drift > 0.1 and other.energy_growth > 0.1
    lost = running.roll(world, 1e-3, 20, None, params.replace(gravity=params.gravity * np.nan))
    assert lost.status and "finite" in lost.flags()[0]


def test_the_page_shows_the_results_that_are_kept():
    """`python benchmarks/hard/page.py` after a run."""
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.rewritten(text) == text and text.count("| right |") > 20


def test_the_picture_and_the_table(tmp_path):
    outcomes = ("right", "flagged: so", "SILENT: x 2 above 1", "crashed: no", "not served: this")
    lines = [
        {"case": f"case {k}", "route": route, "dtype": "float64", "outcome": outcome}
        for k, outcome in enumerate(outcomes)
        for route in ("condensed", "mprgp")
    ]
    hard_cases.write(lines, tmp_path, 1.0)
    assert (tmp_path / "hard_cases.png").stat().st_size > 5000
    assert len((tmp_path / "hard_cases.csv").read_text().splitlines()) == 11


def test_lines_run_again_take_the_place_of_those_that_are_kept(tmp_path):
    def line(case, dtype, outcome):
        return {"case": case, "route": "direct", "dtype": dtype, "outcome": outcome}

    assert hard_cases.among_kept(tmp_path, [line("a", "float64", "right")]) == [line("a", "float64", "right")]
    old = [line("a", "float64", "SILENT: x"), line("b", "float64", "right"), line("a", "float32", "right")]
    (tmp_path / "hard_cases.json").write_text(json.dumps({"lines": old}))
    fresh = [line("c", "float64", "right"), line("a", "float64", "right")]
    assert hard_cases.among_kept(tmp_path, fresh) == [fresh[1], *old[1:], fresh[0]]
