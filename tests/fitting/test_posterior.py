"""Draws from the posterior: those of a line are the ones that a formula gives; a fit's stand in its files."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Gaussian, LogNormal, Noise, Recording, Search, Take, attach, fit_takes, posterior
from jaxfem.fitting.correlation import Channels
from jaxfem.fitting.markers import marker_places
from jaxfem.fitting.weighting import Plain, Weighed, Whitened
from jaxfem.io.fit_json import as_json
from jaxfem.io.fit_search_page import posterior_part

DT, ROWS, NOISE = 0.04, 10, 2e-3


def test_squares_that_jax_can_trace_are_those_of_the_fit():
    """Whitened and weighed residuals of two takes, still samples among them."""
    random = np.random.default_rng(0)
    r = [random.normal(size=(9, 3, 3)), random.normal(size=(7, 2, 3))]
    weights = [random.uniform(1, 2, each.shape) for each in r]
    channels = [
        Channels(0, np.arange(9), np.array([0, 2]), np.arange(-4, 9), random.normal(size=(4, 2, 3)), True, True),
        Channels(0, np.array([1, 2, 5]), np.array([1]), np.array([1, 2, 5]), np.zeros((0, 1, 3)), False, False, 2),
        Channels(1, np.arange(7), np.array([1]), np.arange(7), np.zeros((0, 1, 3)), True, False),
    ]
    for weighting in (Plain(), Weighed(weights), Whitened(weights, channels, (0.8, -0.2))):
        told = sum(each.square(jnp.asarray(own)) for each, own in zip(weighting.maps(2), r, strict=True))
        assert float(told) == pytest.approx(float((weighting.residual(r) ** 2).sum()), rel=1e-10)


def test_scores_of_priors_are_their_rows():
    for prior in (Gaussian(3.0, 0.5), LogNormal(2.0, 1.5)):
        assert float(prior.score(jnp.asarray(2.6))) == pytest.approx(prior.row(2.6)[0])


@functools.cache
def flying(correlation, prior=None):
    """A ball that is thrown along x, and whose speed and place are fitted: a line, of which all is known."""
    ball = jf.RigidBody(jf.Sphere(0.05), mass=0.2, position=(0, 0, 0), velocity=(0.5, 0, 0), name="ball")
    model, params, state = jf.build(jf.Scene([ball], gravity=(0, 0, 0)))
    places = {"top": ("ball", (0, 0, 0.05)), "side": ("ball", (0.05, 0, 0.0))}
    markers = attach(model, places)
    states, _ = jf.rollout(model, params, state, DT, ROWS)
    clean = np.concatenate([np.asarray(marker_places(markers, state))[None], marker_places(markers, states)])
    recording = Recording(
        DT * np.arange(ROWS + 1), clean + NOISE * np.random.default_rng(3).normal(size=clean.shape), tuple(places)
    )
    take = Take(model, params, state, recording, places, DT, compare="position", release=0.0)
    names = ["velocity.ball.x", "place.ball.x"]
    known = correlation == "white"
    noise = Noise(sigma=NOISE if known else None, known=known, correlation=correlation)
    priors = {"velocity.ball.x": prior} if prior else None
    return fit_takes([take], parameters=names, noise=noise, priors=priors, search=Search(candidates=1, polish=6))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nuts", "walk"])
def test_draws_of_a_line_are_those_of_the_formula(kind):
    """Least squares of a line with known noise and a Gaussian prior of the speed: the posterior is Gaussian."""
    pytest.importorskip("blackjax")
    result = flying("white", Gaussian(0.49, 5e-3))
    found = posterior.sample(result, 200 if kind == "nuts" else 1500, kind=kind, chains=4).posterior
    times = DT * np.arange(ROWS + 1)
    columns = np.repeat(np.stack([times, np.ones_like(times)]), 2, axis=1) / NOISE  # two markers
    covariance = np.linalg.inv(columns @ columns.T + np.diag([1 / 5e-3**2, 0.0]))
    draws = found.values.reshape(-1, 2)
    counts = np.array(list(found.effective.values()))
    assert counts.min() > 100 and max(found.scale_reduction.values()) < 1.05 and found.divergent == 0
    bars = np.sqrt(np.diag(covariance))
    assert np.allclose(draws.mean(axis=0), list(result.values.values()), atol=4 * bars.max() / np.sqrt(counts.min()))
    assert np.allclose(draws.std(axis=0), bars, rtol=4 / np.sqrt(2 * counts.min()))
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(covariance[0, 1] / bars.prod(), abs=0.1)


@pytest.mark.slow
def test_draws_stand_in_files_and_page():
    pytest.importorskip("blackjax")
    result = posterior.sample(flying("ar"), 600, kind="walk", chains=2, seed=2)
    told = as_json(result)["posterior"]
    assert len(told["draws"]["place.ball.x"]) == 1200 and told["kind"] == "walk"
    low, high = told["intervals_95"]["velocity.ball.x"]
    assert low < result.values["velocity.ball.x"] < high
    assert high - low == pytest.approx(np.diff(result.intervals["velocity.ball.x"])[0], rel=0.5)
    assert "posterior of place.ball.x: mean" in result.summary()
    part = "".join(posterior_part(result))
    assert 'id="posterior"' in part and part.count("<svg") == 2 and "2 chains of 600 draws" in part


def test_impossible_asks_are_refused():
    class Bare:
        solution = None

    for settings, message in (
        ({"kind": "gibbs"}, "kind"),
        ({"draws": 3}, "draws is 3: give a whole number from 10 up"),
        ({"chains": 0}, "chains is 0"),
    ):
        with pytest.raises(FitError, match=message):
            posterior.sample(Bare(), **settings)
