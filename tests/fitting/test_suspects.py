"""Residuals that an error of the recording leaves are told from those of the model by their shape."""

import types

import numpy as np
import pytest

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.sharing import check_own
from jaxfem.fitting.suspects import suspects, unfollowed

TIMES = np.arange(120) * 0.01
DIRECTIONS = np.array([[0.1, 0.0, 1.0], [-0.1, 0.02, 0.8], [0.05, 0.0, 0.5], [0.0, 0.0, 0.2]])
MARKERS = ("tip", "side", "middle", "base")
STIFFNESS, DAMPING = 1.0, 2.0


def motion(times, stiffness=STIFFNESS, damping=DAMPING):
    """Places (T, 4, 3) of markers of a body that sinks and rings: stiffness moves both how far and how fast."""
    t = np.maximum(times, 0.0)
    sunk = (1 - np.exp(-damping * t) * np.cos(30 * np.sqrt(stiffness) * t)) / stiffness
    overtone = 0.1 * np.exp(-2 * damping * t) * np.sin(130 * np.sqrt(stiffness) * t)
    shape = np.array([1.0, 0.9, -0.6, -0.3])
    return -3e-3 * (sunk[:, None, None] + (overtone[:, None] * shape)[..., None]) * DIRECTIONS


def told(measured, seed=0, fitted=True):
    """Causes that are named for places measured (T, 4, 3) [m] with noise of .02 mm."""
    simulated = motion(TIMES)
    measured = measured + 2e-5 * np.random.default_rng(seed).standard_normal(measured.shape)
    changes = [(1 + 1e-4, 1.0), (1.0, 1 + 1e-4)] if fitted else []
    columns = [(motion(TIMES, STIFFNESS * a, DAMPING * b) - simulated) / 1e-4 for a, b in changes]
    take = types.SimpleNamespace(
        times=TIMES,
        simulated=simulated,
        measured=measured,
        residuals=simulated - measured,
        markers=MARKERS,
        unit="m",
        name="swing",
    )
    weights = np.full(simulated.shape, 1e3)
    return suspects(take, weights, 1e3 * np.array(columns).reshape(-1, *simulated.shape))


def of(marker, changed, usual):
    """`changed` (T, 4, 3) for one marker, `usual` for others."""
    return np.where((np.arange(4) == marker)[:, None], changed, usual)


def lost(count):
    """Rows missing behind the 40th, with times as if none were."""
    return motion(np.where(TIMES >= TIMES[40], TIMES + 0.01 * count, TIMES))


def turned(degrees):
    angle = np.radians(degrees)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    return motion(TIMES) @ turn.T


def smoothed(width):
    """By a Gaussian of this standard deviation [s]."""
    fine = np.arange(-6, 7) * width / 2
    share = np.exp(-0.5 * (fine / width) ** 2)
    return sum(w * motion(TIMES - a) for w, a in zip(share / share.sum(), fine, strict=True))


CASES = {
    "the hand moved": (motion(TIMES) + 0.08 * (motion(TIMES) - motion(TIMES)[0]).mean(axis=0), "% of the motion aside"),
    "one marker late": (of(0, motion(TIMES - 0.02), motion(TIMES)), "tip is 0.021 s (2.1 rows) behind the others"),
    "one marker early": (of(2, motion(TIMES + 0.01), motion(TIMES)), "middle is 0.01 s (1 rows) ahead of the others"),
    "all late": (motion(TIMES - 0.01), "all motion is 0.01 s (1 rows) behind where the release was found"),
    "rows lost": (lost(2), "2 rows were lost at 0.4 s after the release"),
    "one scaled": (of(1, 1.2 * motion(TIMES), motion(TIMES)), "side moves 17 % too much"),
    "axes turned": (turned(5.0), "axes are turned by 5 degrees about (1, "),
    "filtered": (smoothed(0.01), "smoothed over some 0.02 s"),
    "clock": (motion(TIMES * 0.98), "times are 2 % too long"),
}


@pytest.mark.parametrize("name", CASES)
def test_the_cause_is_named(name):
    measured, words = CASES[name]
    found = told(measured)
    assert found and words in found[0], found


def test_noise_alone_and_what_a_fitted_value_would_change_are_no_suspects():
    assert told(motion(TIMES)) == []
    assert told(motion(TIMES, 1.002, 2.02)) == []
    assert told(motion(TIMES), fitted=False) == []


def test_two_causes_are_named_together():
    found = told(of(0, motion(TIMES - 0.01), turned(6.0)))
    assert len(found) == 2 and any("tip is" in each for each in found) and any("turned" in each for each in found)


def test_a_few_rows_tell_no_shape():
    measured = of(0, motion(TIMES - 0.02), motion(TIMES))[:5]
    simulated = motion(TIMES)[:5]
    take = types.SimpleNamespace(times=TIMES[:5], residuals=simulated - measured)
    assert suspects(take, np.ones(simulated.shape), np.zeros((1, *simulated.shape))) == []
    take = types.SimpleNamespace(times=TIMES, residuals=np.zeros((120, 4, 3)))
    assert suspects(take, np.ones((120, 4, 3)), np.full((1, 120, 4, 3), np.nan)) == []  # of steps that failed


def test_residuals_that_ring_are_told_where_they_are_far_above_the_scatter():
    """Their correlations cancel, so that they count as noise: a marker three rows late had no warning."""
    white = types.SimpleNamespace(inflation=1.0, noise=1.0)
    follows = types.SimpleNamespace(name="one", noise=4e-5, scatter=3e-5)
    rings = types.SimpleNamespace(name="two", noise=1.5e-4, scatter=3e-5)
    (told,) = unfollowed(white, [follows, rings])
    assert told.startswith("two: residuals are 5 times")
    assert unfollowed(types.SimpleNamespace(inflation=9.0, noise=1.0), [rings]) == []  # that has a warning of its own


def test_names_in_own_that_are_not_fitted_are_refused():
    shared = types.SimpleNamespace(own=({"young": types.SimpleNamespace(name="young")},))
    check_own(["young", "delay"], shared)
    with pytest.raises(FitError, match=r"own names 'yuong', which is not fitted; fitted: young"):
        check_own(["yuong"], shared)
