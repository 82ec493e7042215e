"""Error bars under noise of many kinds, on linear models in NumPy: bars against the scatter of many draws."""

import numpy as np
import pytest

from jaxfem.fitting import FitError, Noise
from jaxfem.fitting.correlation import Channels, autocorrelations, correlation_matrix, estimated, integrated
from jaxfem.fitting.noise import LOSSES
from jaxfem.fitting.statistics import uncertainty
from jaxfem.fitting.weighting import Plain, Whitened

ROWS, STILL, MARKS = 60, 12, 3


def ringing():
    """Columns (2, T, M, 3) of a size and a damping of something that rings."""
    t = np.arange(ROWS) * 0.01
    wave = np.exp(-3 * t) * np.sin(50 * t)
    shape = np.random.default_rng(9).normal(size=(MARKS, 3))
    return np.stack([wave[:, None, None] * shape, (t * wave)[:, None, None] * 10 * shape])


def drawn(rho, rows, random):
    """Noise (rows, M, 3) of unit variance with autocorrelation rho^lag."""
    white = random.normal(size=(rows, MARKS, 3))
    for k in range(1, rows):
        white[k] = rho * white[k - 1] + np.sqrt(1 - rho**2) * white[k]
    return white


def channels(still):
    """All markers seen throughout, after still rows that tell their places."""
    rows = np.arange(ROWS)
    return [Channels(0, rows, np.arange(MARKS), np.append(np.arange(-len(still), 0), rows), still, True, True)]


def solved(columns, noise, correlation):
    """(estimates less the truth, their bars) of one draw, as a fit makes them."""
    origin = np.median(noise[: STILL + 1], axis=0)
    still, r = origin - noise[:STILL], origin - noise[STILL:]
    there = channels(-still * -1)
    weights = [np.ones((ROWS, MARKS, 3))]
    spread = uncertainty(there, [r], [columns], correlation)
    weighting = Whitened(weights, there, spread.partial) if correlation == "ar" else Plain()
    j, flat = weighting.columns([columns]), weighting.residual([r])
    step = -np.linalg.solve(j @ j.T, j @ flat)
    left = r + np.einsum("p,ptmi->tmi", step, columns)
    spread = uncertainty(there, [left], [columns], correlation)
    return step, np.sqrt(np.diag(spread.covariance)), spread.factor


@pytest.mark.slow
@pytest.mark.parametrize("correlation", ["effective", "ar"])
@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_bars_are_the_scatter_of_many_draws(rho, correlation):
    random, columns = np.random.default_rng(5), ringing()
    off, bars, factors = zip(
        *(solved(columns, drawn(rho, ROWS + STILL, random), correlation) for _ in range(100)), strict=True
    )
    off, bars = np.array(off), np.array(bars)
    ratio = bars.mean(axis=0) / off.std(axis=0)
    assert ((ratio > 0.8) & (ratio < 1.25)).all(), ratio
    covered = (np.abs(off) < np.array(factors)[:, None] * bars).mean(axis=0)
    assert ((covered > 0.88) & (covered < 0.995)).all(), covered


def test_autocorrelations_are_those_of_the_recursion():
    """Against a long simulated series: second order from its partial autocorrelations."""
    partial = (0.8, -0.5)
    phi = np.array([0.8 * (1 + 0.5), -0.5])
    random, x = np.random.default_rng(0), [0.0, 0.0]
    for _ in range(50_000):
        x.append(phi[0] * x[-1] + phi[1] * x[-2] + random.normal())
    x = np.array(x[1000:])
    found = [float((x[: len(x) - k] * x[k:]).mean() / (x * x).mean()) for k in range(8)]
    np.testing.assert_allclose(autocorrelations(partial, 8), found, atol=0.04)
    assert integrated(partial) == pytest.approx(1 + 2 * autocorrelations(partial, 400)[1:].sum(), abs=0.05)
    assert integrated((0.9,)) == pytest.approx(19)
    np.testing.assert_allclose(
        correlation_matrix((0.9,), np.array([0, 1, 4])), 0.9 ** np.array([[0, 1, 4], [1, 0, 3], [4, 3, 0]])
    )


@pytest.mark.parametrize(("rho", "order"), [(0.0, 0), (0.6, 1), (0.9, 1)])
def test_memory_is_found_by_restricted_likelihood(rho, order):
    """Unbiased although each of the nine channels has a level of its own, which takes part of the memory."""
    random, columns, found = np.random.default_rng(1), ringing(), []
    for _ in range(12):
        noise = drawn(rho, ROWS + STILL, random)
        there = channels(noise[:STILL])[0]
        blocks = [(there, there.extended(noise[STILL:], True), there.extended(columns, False))]
        found.append(estimated(blocks))
    assert np.mean([len(each) == order for each in found]) > 0.7
    if order:
        assert np.mean([each[0] for each in found]) == pytest.approx(rho, abs=0.03)


@pytest.mark.parametrize("word", LOSSES)
def test_influence_has_its_slope_and_weight(word):
    loss, u = LOSSES[word], np.linspace(-5, 5, 41) + 0.01
    slope = (loss.influence(u + 1e-6) - loss.influence(u - 1e-6)) / 2e-6
    np.testing.assert_allclose(loss.slope(u), slope, atol=1e-5)
    np.testing.assert_allclose(loss.weight(u) * u, loss.influence(u), atol=1e-12)
    assert loss.weight(np.zeros(1)) == pytest.approx(1.0, abs=0.26)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"correlation": "pink"}, "give one of effective, white, ar"),
        ({"loss": "cube"}, "give one of square, huber, student"),
        ({"groups": "markers"}, '"all", "take", "marker"'),
        ({"known": True}, "no sigma is given"),
        ({"known": True, "sigma": 1e-4, "groups": "marker"}, "leave one out"),
    ],
)
def test_impossible_noise_is_refused(settings, message):
    with pytest.raises(FitError, match=message):
        Noise(**settings)
    with pytest.raises(FitError, match='names no marker "b"'):
        Noise(sigma={"a": 1e-4}).scale(("a", "b"), 1.0)
