"""Takes of one body that do not agree: told at once to first order, then by fits of each alone."""

import dataclasses

import jsonschema
import numpy as np
import pytest
from test_takes import DT, PLACES, QUICK, ROWS, Beam

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, alone, fit_takes, marker_positions
from jaxfem.fitting.agreement import agreement
from jaxfem.io.fit_json import SCHEMA, as_json
from jaxfem.io.fit_report import write_report

NAMES = ("young", "damping", "delay")


def test_values_that_scatter_as_their_bars_say_have_the_weighted_mean():
    found = agreement("young", {"a": 10.0, "b": 10.6, "c": 9.9}, {"a": 0.5, "b": 0.5, "c": 1.0})
    assert found.agree and found.between == 0
    assert found.mean == pytest.approx((4 * 10 + 4 * 10.6 + 9.9) / 9)
    assert found.interval[1] - found.mean == pytest.approx(1.96 / 3, rel=1e-3)


def test_values_that_do_not_have_the_scatter_that_explains_them():
    """Its definition (Paule & Mandel 1982), and Student's interval around the mean."""
    x, bars = {"a": 1.0, "b": 2.0, "c": 4.0}, {"a": 0.1, "b": 0.1, "c": 0.3}
    found = agreement("young", x, bars)
    v = np.square([*bars.values()]) + found.between**2
    assert not found.agree and sum((np.array([*x.values()]) - found.mean) ** 2 / v) == pytest.approx(2, rel=1e-6)
    assert found.interval[1] - found.mean == pytest.approx(4.3027 / np.sqrt(sum(1 / v)), rel=1e-4)
    assert "do not agree" in found.line() and "a 1 +- 0.1" in found.line()


def test_values_without_error_bars_are_compared_too():
    """Exact data leave bars of nothing."""
    same, other = ({"a": 2.0, "b": value} for value in (2.0, 2.1))
    assert agreement("k", same, dict.fromkeys("ab", 0.0)).agree
    apart = agreement("k", other, dict.fromkeys("ab", 0.0))
    assert not apart.agree and apart.between == pytest.approx(0.1 / np.sqrt(2)) and apart.mean == pytest.approx(2.05)


def test_intervals_hold_the_mean_of_all_takes_as_often_as_they_say():
    rng, held = np.random.default_rng(0), 0
    for _ in range(1000):
        bars = rng.uniform(0.2, 1.0, 5)
        x = 3.0 + 1.5 * rng.normal(size=5) + bars * rng.normal(size=5)
        words = "abcde"
        low, high = agreement("k", dict(zip(words, x, strict=True)), dict(zip(words, bars, strict=True))).interval
        held += low < 3.0 < high
    assert 0.92 < held / 1000 < 0.98


@pytest.fixture(scope="module")
def beam():
    return Beam()


def of_another(beam, young, seed):
    """A recording of the beam with another Young's modulus, under the second load."""
    params = beam.params_under(0.1).replace(young=young)
    states, _ = jf.rollout(beam.model, params, beam.state, DT, ROWS)
    first = np.asarray(marker_positions(beam.markers, beam.state.positions))[None]
    places = np.concatenate([np.repeat(first, 7, 0), marker_positions(beam.markers, states.positions)])
    places = places + 2e-5 * np.random.default_rng(seed).normal(size=places.shape)
    return Recording(DT * np.arange(len(places)), places, tuple(PLACES))


@pytest.mark.slow
def test_takes_of_one_body_agree(beam):
    takes = [beam.take("light", 0.0, seed=1), beam.take("heavy", 0.1, seed=2)]
    found = fit_takes(takes, parameters=NAMES, search=QUICK)
    assert not [text for text in found.warnings if "do not agree" in text]
    told = alone(
        found, takes, parameters=NAMES, search=QUICK, bounds={"young": (1e4, 1e7), "delay_light": (-0.01, 0.01)}
    )
    assert [each.name for each in told.agreement] == ["young", "damping"] and all(each.agree for each in told.agreement)
    assert told.warnings == found.warnings
    young = told.agreement[0]
    assert young.mean == pytest.approx(found.values["young"], rel=2e-3)
    assert young.interval[0] < 2e5 < young.interval[1]
    with pytest.raises(FitError, match="only one take was fitted"):
        alone(fit_takes(takes, parameters=NAMES, search=QUICK, held_out="heavy"), takes)
    with pytest.raises(FitError, match='no take is named "heavy"'):
        alone(found, takes[:1])


@pytest.mark.slow
def test_a_take_that_cannot_be_fitted_alone_is_named(beam):
    """Under its own weight a body tells modulus over density: the other take has both to itself."""
    start = {"young": 2.5e5, "density": 1200.0}
    takes = [beam.take(name, newton, 1e-5, seed, start) for name, newton, seed in (("own", 0.0, 1), ("loaded", 0.1, 2))]
    settings = {"parameters": ("young", "density"), "search": QUICK}
    told = alone(fit_takes(takes, **settings), takes, **settings)
    assert any(text.startswith("own cannot be fitted alone, and is not compared: ") for text in told.warnings)
    assert told.agreement == () and not [text for text in told.warnings if "do not agree" in text]


@pytest.mark.slow
def test_takes_of_two_bodies_are_told_apart(beam, tmp_path):
    takes = [beam.take("light", 0.0, seed=1), beam.take("heavy", 0.1, recording=of_another(beam, 2.3e5, 2))]
    found = fit_takes(takes, parameters=NAMES, search=QUICK)
    (told,) = (text for text in found.warnings if "takes do not agree on young" in text)
    assert "light to" in told and "heavy to" in told
    apart = alone(found, takes, parameters=NAMES, search=QUICK)
    young = apart.agreement[0]
    assert not young.agree and young.chance < 1e-9
    for take, true in (("light", 2e5), ("heavy", 2.3e5)):
        assert young.values[take] == pytest.approx(true, abs=4 * young.errors[take])
    assert young.between == pytest.approx(3e4 / np.sqrt(2), rel=0.05)  # of two values, their standard deviation
    low, high = young.interval
    assert low < 2e5 < 2.3e5 < high
    assert any("do not agree, and scatter by" in text for text in apart.warnings) and "takes alone" in apart.summary()
    told = as_json(apart)
    jsonschema.validate(told, SCHEMA)
    assert told["takes_alone"][0]["values"] == young.values
    page = write_report(tmp_path / "report.html", apart).read_text()
    assert 'id="alone"' in page and "do not agree" in page
    assert (
        'id="alone"' not in write_report(tmp_path / "plain.html", dataclasses.replace(apart, agreement=())).read_text()
    )
