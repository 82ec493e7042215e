"""Fits that start far off: drawn starts and their waterfall, windows that grow, restitution; memory within a limit."""

import dataclasses

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Search, Take, attach, fit_takes
from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.markers import marker_places
from jaxfem.fitting.memory import bytes_of, limit_memory
from jaxfem.fitting.multistart import doubts, drawn, in_words, waterfall
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.recovery import assembled
from jaxfem.fitting.unknowns import Unknowns
from jaxfem.io.fit_json import as_json
from jaxfem.io.fit_search_page import waterfall_part
from jaxfem.materials.constants import Constant
from jaxfem.materials.quantities import signed_constant

DT, ROWS, NOISE = 0.01, 120, 5e-4
TRUE = {"velocity.ball.z": 2.0, "contact.floor.restitution": 0.8}
FAR = {"velocity.ball.z": 1.2, "contact.floor.restitution": 0.7}
PLACES = {"top": ("ball", (0, 0, 0.3)), "side": ("ball", (0.05, 0, 0.25)), "back": ("ball", (0, 0.05, 0.25))}
QUICK = Search(candidates=1, polish=15, tol=1e-6)


def bouncing(speed, restitution):
    """A ball that flies to and fro between floor and ceiling, without gravity: a sawtooth, whose pitch is the speed."""
    ball = jf.RigidBody(jf.Sphere(0.05), mass=0.2, position=(0, 0, 0.25), velocity=(0, 0, speed), name="ball")
    above = jf.Plane(point=(0, 0, 0.5), normal=(0, 0, -1))
    floor = jf.Contact(ball, jf.Plane(), friction=0.0, restitution=restitution, name="floor")
    ceiling = jf.Contact(ball, above, friction=0.0, restitution=0.9, name="ceiling")
    return jf.build(jf.Scene([ball], contacts=[floor, ceiling], gravity=(0, 0, 0)))


@pytest.fixture(scope="module")
def take():
    """A recording of six bounces, with noise, on a scene with values that are far off."""
    model, params, state = bouncing(*TRUE.values())
    markers = attach(model, PLACES)
    states, infos = jf.rollout(model, params, state, DT, ROWS)
    assert not np.asarray(infos.status).any()
    clean = np.concatenate([np.asarray(marker_places(markers, state))[None], marker_places(markers, states)])
    noisy = clean + NOISE * np.random.default_rng(0).normal(size=clean.shape)
    recording = Recording(DT * np.arange(ROWS + 1), noisy, tuple(PLACES))
    return Take(*bouncing(*FAR.values()), recording, PLACES, DT, compare="position", release=0.0)


def right(result):
    """Whether both values are those of the recording, to 2 % and to their bars."""
    off = {name: result.values[name] - true for name, true in TRUE.items()}
    return all(abs(off[n]) < min(0.02 * TRUE[n], 4 * result.standard_errors[n]) for n in TRUE)


@pytest.mark.slow
def test_restitution_comes_back_from_bounces(take):
    near = {"velocity.ball.z": 2.2, "contact.floor.restitution": 0.6}
    result = fit_takes([take], parameters=list(TRUE), starts=[near], search=QUICK)
    assert result.status == "converged" and right(result) and not result.ends


@pytest.mark.slow
def test_steps_shorter_than_the_samples_are_searched_coarsely_first(take):
    """Free flight and impacts are exact at any step: a quarter of it finds the same values."""
    near = {"velocity.ball.z": 2.2, "contact.floor.restitution": 0.6}
    finer = dataclasses.replace(take, dt=DT / 4)
    result = fit_takes([finer], parameters=list(TRUE), starts=[near], search=QUICK)
    assert right(result) and result.takes[0].dt == pytest.approx(DT / 4)


@pytest.mark.slow
def test_windows_that_grow_find_what_the_whole_recording_hides(take):
    """With a pitch that is off, later bounces pull the wrong way; the first ones tell the speed."""
    alone = fit_takes([take], parameters=list(TRUE), search=QUICK)
    assert not right(alone) and alone.loss > 0.1
    result = fit_takes([take], parameters=list(TRUE), search=QUICK, windows=6)
    assert right(result) and {"windows", "polish"} <= {visit.stage for visit in result.history}


@pytest.mark.slow
def test_drawn_starts_find_it_too_and_tell_where_each_led(take):
    bounds = {"velocity.ball.z": (0.5, 4.0), "contact.floor.restitution": (0.5, 0.99)}
    result = fit_takes([take], parameters=list(TRUE), bounds=bounds, search=QUICK, multi_start=8)
    assert right(result) and len(result.ends) == 9 and sum(not end.drawn for end in result.ends) == 1
    losses = [end.loss for end in result.ends]
    assert losses == sorted(losses) and 1 <= sum(end.best for end in result.ends) < 9
    assert all(end.best == (end.loss < 1.02 * losses[0]) for end in result.ends)
    assert any("worse minimum than drawn starts" in text for text in result.warnings)  # the usual search is trapped
    assert in_words(result.ends) in result.summary()
    told = as_json(result)["starts_followed"]
    assert len(told) == 9 and told[0]["values"] == result.ends[0].values
    part = "".join(waterfall_part(result))
    assert 'id="waterfall"' in part and "the best" in part and part.count("<tr>") == 10


@pytest.mark.slow
def test_columns_made_one_after_another_are_the_same(take):
    evaluator, *_, shared = assembled([take], list(TRUE), (), None, None, Noise(), None, "refuse")
    z = shared.starts[0]
    residual, jacobian, _ = evaluator.linear(z)
    whole = bytes_of(evaluator.pieces[0])
    limited = Evaluator(evaluator.pieces, evaluator.unknowns)
    limit_memory(limited, whole / 1e9)
    assert limited.pieces[0].plan.at_once is None  # it fits
    piece = dataclasses.replace(evaluator.pieces[0].plan, at_once=1)
    limited.pieces = (dataclasses.replace(evaluator.pieces[0], plan=piece),)
    one, columns, _ = limited.linear(z)
    assert np.allclose(one[0], residual[0], atol=1e-12) and np.allclose(columns[0], jacobian[0], atol=1e-10)
    with pytest.raises(FitError, match="more than max_memory"):
        limit_memory(limited, 1e-9)


UNKNOWNS = Unknowns(
    (Constant("young", "Pa", ""), signed_constant("pull", "N", "")), np.array([1e3, -500.0]), np.array([1e7, 500.0])
)


def test_starts_are_spread_within_bounds_or_about_the_first():
    first = UNKNOWNS.unknown({"young": 1e5, "pull": 2.0})
    near = np.array(drawn(UNKNOWNS, first, (), 10, 0))
    assert np.allclose(np.sort(near[:, 0] - first[0]), np.log(10) * np.linspace(-0.9, 0.9, 10), atol=0.1 * np.log(10))
    assert (np.abs(near[:, 1] - 2.0) < 2.0).all() and np.ptp(near[:, 1]) > 3.0
    wide = np.array(drawn(UNKNOWNS, first, ("young",), 10, 0))
    assert np.log(1e3) <= wide[:, 0].min() < np.log(3e3) and np.log(4e6) < wide[:, 0].max() <= np.log(1e7)
    assert np.array_equal(drawn(UNKNOWNS, first, (), 10, 0), near) and not np.array_equal(
        drawn(UNKNOWNS, first, (), 10, 1), near
    )


def test_a_best_that_few_found_is_told():
    z = UNKNOWNS.unknown({"young": 1e5, "pull": 2.0})
    ends = [(z, z, loss) for loss in (2.0, 1.0, 1.001, 5.0, np.inf)]
    fall = waterfall(UNKNOWNS, ends, 1000, 1.0)
    assert [end.loss for end in fall] == [1.0, 1.001, 2.0, 5.0, np.inf]
    assert [end.best for end in fall] == [True, True, False, False, False] and not fall[2].drawn
    assert in_words(fall) == "2 of 5 starts led to the best; the next ended at 2 times its loss"
    assert ["worse minimum" in text for text in doubts(fall)] == [True]
    assert waterfall(UNKNOWNS, ends, 100_000, 1.0)[1].best is False  # more samples tell them apart,
    assert waterfall(UNKNOWNS, ends, 100_000, 40.0)[1].best  # those that say the same do not
    alone = waterfall(UNKNOWNS, [ends[1], ends[0], ends[3]], 1000, 1.0)
    assert len(doubts(alone)) == 1 and "only 1 of 3 starts" in doubts(alone)[0] and doubts(()) == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"multi_start": -1}, "multi_start is -1: give a whole number from 0 up"),
        ({"windows": 0}, "windows is 0: give a whole number from 1 up"),
        ({"windows": 60}, "a take has 121 samples: give at most 30"),
        ({"max_memory": 0}, "max_memory is 0: give a size in GB"),
    ],
)
def test_impossible_counts_are_refused(take, settings, message):
    with pytest.raises(FitError, match=message):
        fit_takes([take], parameters=list(TRUE), **settings)
