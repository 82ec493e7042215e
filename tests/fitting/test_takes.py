"""Several recordings at once, some held out; what is known before; markers of different quality; outliers."""

import dataclasses
import gc
import weakref

import jax
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import (
    FitError,
    Gaussian,
    LogNormal,
    Noise,
    Recording,
    Search,
    Take,
    attach,
    contributions,
    fit_takes,
    marker_positions,
    profile,
    sensitivity,
)

DT, ROWS = 1e-2, 30
TRUE = {"young": 2e5, "damping": 3e-3}
PLACES = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "middle": (0.05, 0.015, 0.03)}
QUICK = Search(candidates=1, polish=12, tol=1e-6)


class Beam:
    """A beam of one cell across, let go under its weight and under other loads: one program for all takes."""

    def __init__(self):
        mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
        load = jf.NodalForce("x+", (0.0, 0.0, 0.0))
        body = jf.SoftBody(mesh, 2e5, 0.35, 1070.0, damping=3e-3, fixed="x-", loads=[load])
        self.model, self.params, self.state = jf.build(jf.Scene([body]), scheme="generalized_alpha")
        self.markers = attach(self.model, PLACES)

    def params_under(self, newton):
        return self.params.replace(loads=(np.array([0.0, 0.0, -newton / 4]),))  # N a node, four of them

    def recording(self, newton=0.0, noise=0.0, seed=0, still=6):
        states, _ = jf.rollout(self.model, self.params_under(newton), self.state, DT, ROWS)
        first = np.asarray(marker_positions(self.markers, self.state.positions))[None]
        places = np.concatenate([np.repeat(first, still + 1, 0), marker_positions(self.markers, states.positions)])
        places = places + noise * np.random.default_rng(seed).normal(size=places.shape)
        return Recording(DT * np.arange(len(places)), places, tuple(PLACES))

    def take(self, name, newton=0.0, noise=2e-5, seed=0, start=None, recording=None):
        params = self.params_under(newton).replace(**(start or {"young": 3e5, "damping": 1e-3}))
        recording = recording or self.recording(newton, noise, seed)
        return Take(self.model, params, self.state, recording, self.markers, DT, release=0.06, name=name)


@pytest.fixture(scope="module")
def beam():
    return Beam()


def inside(result, name, value):
    return abs(result.values[name] - value) < 3.5 * result.standard_errors[name]


@pytest.mark.slow
def test_takes_share_values_and_one_is_held_out(beam):
    takes = [beam.take("light", 0.0, seed=1), beam.take("heavy", 0.1, seed=2), beam.take("other", 0.05, seed=3)]
    names = ("young", "damping", "delay")
    both = fit_takes(takes, parameters=names, held_out="other", search=QUICK)
    one = fit_takes(takes[:1], parameters=names, search=QUICK)
    assert list(both.values) == ["young", "damping", "delay_light", "delay_heavy"] and list(one.values) == list(names)
    assert all(inside(both, name, value) for name, value in TRUE.items())
    assert both.standard_errors["young"] < one.standard_errors["young"]
    low, high = both.intervals["young"]
    assert low < both.values["young"] < high and high - both.values["young"] > both.values["young"] - low  # of its log
    light, heavy, other = both.takes
    assert [each.held_out for each in both.takes] == [False, False, True] and set(other.values) == set(names)
    for each in (light, heavy, other):
        assert each.noise == pytest.approx(2e-5, rel=0.2) and each.scatter == pytest.approx(2e-5, rel=0.4)
        assert 0.9 < each.covered <= 1 and "worst" in each.line()
    assert float(other.params.young) == both.values["young"] and "other (held out)" in both.summary()


@pytest.mark.slow
def test_a_known_weight_tells_modulus_and_density_apart(beam):
    """Under its own weight only the ratio is there to be found; a known force beside it gives both."""
    names = ("young", "density")
    own = beam.take("own", noise=1e-5, seed=1, start={"young": 2.5e5, "density": 1200.0})
    with pytest.raises(FitError, match="only young/density can be found"):
        fit_takes([own], parameters=names, search=QUICK)
    loaded = beam.take("loaded", 0.1, noise=1e-5, seed=2, start={"young": 2.5e5, "density": 1200.0})
    found = fit_takes([own, loaded], parameters=names, search=QUICK)
    assert inside(found, "young", 2e5) and inside(found, "density", 1070.0)
    assert found.standard_errors["young"] < 0.03 * 2e5 and "known worst" in found.weakest
    known = fit_takes([own], parameters=names, search=QUICK, priors={"density": Gaussian(1070.0, 5.0)})
    assert known.standard_errors["density"] == pytest.approx(5.0, rel=0.1)
    assert known.values["young"] == pytest.approx(2e5, rel=0.01)


@pytest.mark.slow
def test_priors_pull_as_their_width_says(beam):
    """Two pieces of knowledge of one value meet at their weighted mean (of the logarithm), with the sum of weights."""
    take = beam.take("take", noise=3e-4, seed=4)
    free = fit_takes([take], parameters="young", search=QUICK)
    bar = free.standard_errors["young"] / free.values["young"]
    middle = free.values["young"] * np.exp(-bar)
    told = fit_takes([take], parameters="young", search=QUICK, priors={"young": LogNormal(middle, np.exp(bar))})
    assert told.values["young"] == pytest.approx(np.sqrt(middle * free.values["young"]), rel=0.1 * bar)
    # least squares weighs samples as if their places of origin were exact, so a little less than both could give
    assert 0.95 / np.sqrt(2) < told.standard_errors["young"] / told.values["young"] / bar < 0.9
    for priors, message in (
        ({"poisson": Gaussian(0.3, 0.1)}, '"poisson", which is not fitted'),
        ({"young": 2e5}, "give a Gaussian"),
    ):
        with pytest.raises(FitError, match=message):
            fit_takes([take], parameters="young", priors=priors)


@pytest.mark.slow
def test_a_poor_marker_and_outliers_count_less(beam):
    good = beam.recording(0.0, 1e-5, seed=5)
    shaky = good.positions.copy()
    shaky[:, 1] += 4e-4 * np.random.default_rng(1).normal(size=shaky[:, 1].shape)
    take = beam.take("take", recording=Recording(good.times, shaky, good.names))
    alike, apart = (
        fit_takes([take], parameters=tuple(TRUE), search=QUICK, noise=Noise(groups=g)) for g in ("all", "marker")
    )
    assert apart.standard_errors["young"] < 0.3 * alike.standard_errors["young"] and inside(apart, "young", 2e5)
    assert apart.sigmas["left"] == pytest.approx(4e-4, rel=0.25) and apart.sigmas["tip"] == pytest.approx(1e-5, rel=0.4)
    assert apart.takes[0].worst[0] == "left"
    spoilt = good.positions.copy()
    random = np.random.default_rng(2)
    spoilt[8:] += 3e-4 * (random.random(spoilt[8:].shape) < 0.1)
    take = beam.take("take", recording=Recording(good.times, spoilt, good.names))
    plain, robust = (
        fit_takes([take], parameters=tuple(TRUE), search=QUICK, noise=Noise(loss=w)) for w in ("square", "student")
    )
    off = [abs(each.values["young"] / 2e5 - 1) for each in (plain, robust)]
    assert off[1] < 0.5 * off[0] and robust.standard_errors["young"] < 0.3 * plain.standard_errors["young"]


def test_what_takes_contradict_is_refused(beam):
    take = beam.take("take")
    for takes, settings, message in (
        ([], {}, "no take"),
        ([take, take], {}, 'two takes are named "take"'),
        ([take, dataclasses.replace(take, name="again")], {}, "the very same samples"),
        ([take], {"held_out": "other"}, 'no take "other"'),
        ([take], {"held_out": "take"}, "all takes are held out"),
        ([take], {"noise": Noise(), "sigma": 1e-4}, "sigma is given beside noise"),
    ):
        with pytest.raises(FitError, match=message):
            fit_takes(takes, parameters="young", **settings)


@pytest.mark.slow
def test_what_tells_most_is_what_a_fit_finds(beam):
    """Expected error bars are those of the fit; shares sum to one; a driven load's take tells more of the density."""
    takes = [beam.take("own", noise=2e-5, seed=1, start=TRUE), beam.take("loaded", 0.1, 2e-5, seed=2, start=TRUE)]
    told = {each.name: each for each in sensitivity(takes, 2e-5, parameters=("young", "damping"))}
    found = fit_takes(takes, parameters=("young", "damping"), search=QUICK, noise=Noise(sigma=2e-5, known=True))
    for name, each in told.items():
        assert found.standard_errors[name] == pytest.approx(each.standard_error, rel=0.1)
        for shares in (each.takes, each.markers, each.axes, each.windows):
            assert sum(shares.values()) == pytest.approx(1.0)
    assert told["young"].markers["tip"] > told["young"].markers["middle"]
    assert told["young"].takes["loaded"] > told["young"].takes["own"] and "along z" in told["young"].line()
    with pytest.raises(FitError, match="only young/density can be found"):
        sensitivity(takes[:1], 2e-5, parameters=("young", "density", "damping"))


@pytest.mark.slow
def test_profiles_end_where_bars_of_a_linear_problem_do(beam):
    found = fit_takes([beam.take("take", seed=1)], parameters=("young", "damping"), search=QUICK)
    got = profile(found, "young")
    assert got.interval == pytest.approx(found.intervals["young"], rel=2e-3)
    assert (got.drop >= -1e-6).all() and got.values[np.argmin(got.drop)] == pytest.approx(found.values["young"])
    with pytest.raises(FitError, match='"poisson" was not fitted'):
        profile(found, "poisson")
    value, bar = found.values["young"], found.standard_errors["young"]
    narrow = {"young": LogNormal(value, 1 + 0.5 * bar / value)}
    known = fit_takes([beam.take("take", seed=1)], parameters=("young", "damping"), search=QUICK, priors=narrow)
    low, high = known.intervals["young"]
    assert high - low < 0.8 * np.diff(found.intervals["young"])[0]
    assert np.diff(profile(known, "young").interval)[0] == pytest.approx(high - low, rel=0.05)


@pytest.mark.slow
def test_a_value_that_only_has_a_limit_gets_a_one_sided_interval(beam):
    """Where a bound comes before the likelihood has fallen, the interval has no end on that side."""
    take = beam.take("take", seed=1)
    free = fit_takes([take], parameters=("young", "damping"), search=QUICK)
    nearest = free.values["young"] - free.standard_errors["young"]
    found = fit_takes([take], parameters=("young", "damping"), search=QUICK, bounds={"young": (nearest, 1e6)})
    low, high = profile(found, "young").interval
    assert low == -np.inf and high == pytest.approx(free.intervals["young"][1], rel=2e-3)


@pytest.mark.slow
def test_held_values_and_marker_places_add_what_refits_show(beam):
    """The density's share by sensitivity, against a fit with the density changed; E goes with it."""
    take = beam.take("take", noise=0.0, start=TRUE)
    found = fit_takes([take], parameters=("young", "damping"), search=QUICK)
    density, markers = contributions(found, {"density": 0.01}, places=1e-3)
    heavier = dataclasses.replace(take, params=take.params.replace(density=1070.0 * 1.01))
    again = fit_takes([heavier], parameters=("young", "damping"), search=QUICK)
    for name in TRUE:
        assert density.shift[name] == pytest.approx(
            again.values[name] - found.values[name], rel=0.05, abs=2e-3 * TRUE[name]
        )
    assert density.shift["young"] == pytest.approx(0.01 * 2e5, rel=0.05) and density.by == "1 %"
    moved = {**PLACES, "tip": (0.101, 0.015, 0.03)}
    off = dataclasses.replace(take, markers=attach(beam.model, moved))
    change = fit_takes([off], parameters=("young", "damping"), search=QUICK).values["young"] - found.values["young"]
    assert 0.5 * abs(change) < markers.shift["young"] < 10 * abs(change) and markers.by == "1 mm each"
    along, _, up = (each.shift["young"] / 2e5 for each in contributions(found, geometry=0.01))
    # between beams that bend, L^4 / (E h^2), and that shear, L^2 / E; linear elements lock
    assert 0.02 < along < 0.04 and -0.02 < up < 0
    for held, message in (({"young": 0.1}, "young was fitted"), ({"friction": 0.1}, 'no constant "friction"')):
        with pytest.raises(FitError, match=message):
            contributions(found, held)


@pytest.mark.slow
def test_equal_fits_compile_once_and_leave_nothing_behind(beam):
    """What one fit compiled serves the next: its time, and its memory in a process that fits hundreds."""
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )

    def fitted(seed, frame):
        heard = Heard()
        take = dataclasses.replace(beam.take("take", seed=seed), frame=frame)
        other = dataclasses.replace(beam.take("other", seed=seed + 1), frame=frame)
        found = fit_takes(
            [take, other], parameters=tuple(TRUE), held_out="other", search=QUICK, progress=heard, checks="warn"
        )
        return found, weakref.ref(heard)

    for frame in ("none", "rest"):
        fitted(0, frame)
        before = len(compiled)
        kept = [fitted(seed, frame) for seed in (1, 2)]
        assert len(compiled) == before
        gc.collect()
        assert all(heard() is None for _, heard in kept)  # a result does not hold what was told of its making


class Heard:
    """Who is told of a fit's progress."""

    def __call__(self, *visit):
        pass


def test_nearests_outside_jit_compile_once():
    nearest = jf.rotation.nearest_rotation
    program = nearest if hasattr(nearest, "_cache_size") else nearest.__wrapped__  # without its contract
    before = program._cache_size()
    for size in (1.0, 2.0, 3.0):
        np.testing.assert_allclose(nearest(size * np.eye(3)[None, None]), np.eye(3)[None, None])
    assert program._cache_size() == before + 1
