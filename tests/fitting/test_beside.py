"""What was measured beside markers: each kind against formulas and the simulation, in fits, in files, in pages."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.declared.loads import Load
from jaxfem.fitting import (
    FitError,
    Frequencies,
    Gauge,
    Gaussian,
    Recording,
    Search,
    Settled,
    SupportForce,
    Take,
    attach,
    contributions,
    fit_takes,
    marker_positions,
)
from jaxfem.fitting.beside import data_of
from jaxfem.fitting.paths import placed_constants, value_of
from jaxfem.io.fit_beside import beside_of
from jaxfem.io.fit_json import take_as_json
from jaxfem.io.fit_search_page import beside_part
from jaxfem.io.toml_tables import SceneFileError, Table
from jaxfem.pytrees import Pytree

DT, ROWS = 1e-2, 24
PLACES = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "middle": (0.05, 0.015, 0.03)}
QUICK = Search(candidates=1, polish=12, tol=1e-6)
NAMES = ("young", "density", "load.0")
WEIGHT = 0.1 * 0.03 * 0.03 * 1070.0 * 9.81


class Beam:
    """A beam of two cells, held at one end, with a pressure on its top."""

    def __init__(self, dtype=jnp.float64):
        mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
        load = jf.Pressure("z+", 100.0)
        body = jf.SoftBody(mesh, 2e5, 0.35, 1070.0, damping=3e-3, fixed="x-", loads=[load], name="beam")
        self.model, self.params, self.state = jf.build(jf.Scene([body]), scheme="generalized_alpha", dtype=dtype)
        self.markers = attach(self.model, PLACES)
        known = {**placed_constants(self.model, self.params, self.state), **self.model.constants}
        self.fitted = {name: known[name] for name in NAMES}

    def told(self, datum, **changed):
        """What the scene tells of a datum, with some constants changed."""
        params = self.params.replace(**{name: jnp.asarray(v, self.model.rest.dtype) for name, v in changed.items()})
        scene = self.model, params, self.state, self.markers
        one = self.data_of(datum, scene)
        z = [each.transform.unknown(value_of(each, params, self.state)) for each in self.fitted.values()]
        return one, np.array(z)

    def data_of(self, datum, scene):
        """One program for each kind: the one that a fit of NAMES takes."""
        return data_of([datum], scene, NAMES, self.fitted, DT, DT)[0]

    def recording(self, noise=1e-5):
        states, _ = jf.rollout(self.model, self.params, self.state, DT, ROWS)
        first = np.asarray(marker_positions(self.markers, self.state.positions))[None]
        places = np.concatenate([np.repeat(first, 6, 0), marker_positions(self.markers, states.positions)])
        places = places + noise * np.random.default_rng(0).normal(size=places.shape)
        return Recording(DT * np.arange(len(places)), places, tuple(PLACES))

    def take(self, beside=(), **start):
        params = self.params.replace(**{"young": 3e5, "density": 1200.0, **start})
        return Take(
            self.model, params, self.state, self.recording(), self.markers, DT, release=0.05, name="t", beside=beside
        )


@pytest.fixture(scope="module")
def beam():
    return Beam()


def measured(beam):
    """What instruments would read off the true beam: frequencies, its shape at rest, the force on the clamp."""
    rest, _ = jf.equilibrium(beam.model, beam.params, beam.state)
    omega, _ = jf.modes(beam.model, beam.params, rest, 2)
    shape = marker_positions(beam.markers, rest.positions) - marker_positions(beam.markers, beam.state.positions)
    return np.asarray(omega) / (2 * np.pi), dict(zip(PLACES, np.asarray(shape).tolist(), strict=True))


@pytest.mark.parametrize(
    "kind",
    ["frequencies", "settled", "force at rest", "force over time", "gauge"],
)
@pytest.mark.slow
def test_each_kind_tells_what_it_should_with_its_derivatives(beam, kind):
    """At the true values nothing is off; derivatives by central differences."""
    hertz, shape = measured(beam)
    data = {
        "frequencies": Frequencies(hertz, 0.05),
        "settled": Settled(shape, 1e-4),
        # the clamp carries the weight, and what presses on the top
        "force at rest": SupportForce((np.nan, np.nan, -WEIGHT), 1e-3),
        "force over time": SupportForce(np.full((2, 3), -1.0), 0.01, times=(0.02, 0.035)),
        "gauge": Gauge(1e5, 1e3, path="young"),
    }
    datum = data[kind]
    one, z = beam.told(datum)
    rows, slopes = one.rows(z)
    if kind in ("frequencies", "settled"):
        np.testing.assert_allclose(rows, 0, atol=1e-5)
    if kind == "gauge":
        assert rows[0] == pytest.approx(100.0) and one.told(z)[0].predicted == pytest.approx(2e5)
    if kind == "force at rest":
        assert [each.what for each in one.told(z)] == ["force on the support, z"]
        free = dataclasses.replace(datum, values=(np.nan, 0.0, -WEIGHT))
        bare = z.copy()
        bare[NAMES.index("load.0")] = beam.fitted["load.0"].transform.unknown(0.0)
        np.testing.assert_allclose(beam.told(free)[0].rows(bare)[0][1:], 0, atol=1e-6)
    for k in range(2):
        step = np.zeros(3)
        step[k] = 1e-4
        there, back = (beam.told(datum)[0].rows(z + sign * step)[0] for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, k], (there - back) / 2e-4, rtol=2e-3, atol=2e-3)


@pytest.mark.slow
def test_the_force_over_time_is_what_momentum_asks_for(beam):
    """Loads less the clamp's force change the body's momentum: summed over the steps, as backward differences do."""
    steps, dt = 40, 2.5e-4
    states, _ = jf.rollout(beam.model, beam.params, beam.state, dt, steps)
    times = dt * np.arange(steps + 1)
    datum = SupportForce(np.zeros((steps + 1, 3)), 1.0, times=times)
    scene = beam.model, beam.params, beam.state, beam.markers
    own = {"young": beam.model.constants["young"]}
    force = data_of([datum], scene, list(own), own, dt, dt)[0].rows(np.log([2e5]))[0]
    force = force.reshape(-1, 3)
    mass = np.asarray(jf.model.nodal_mass(beam.model, beam.params.density)) * np.asarray(beam.model.free)
    momentum = float(mass @ np.asarray(states.velocities[-1])[:, 2])
    area = 0.1 * 0.03  # of the top; its turn is small
    impulse = (-WEIGHT - 100.0 * area) * steps * dt - np.trapezoid(force[:, 2], times)
    assert momentum == pytest.approx(impulse, rel=0.02)


@pytest.mark.slow
def test_a_force_and_a_frequency_tell_density_and_modulus_apart(beam):
    """Markers under the body's own weight tell E/density alone; load cell, tap and settled shape beside give all."""
    hertz, shape = measured(beam)
    with pytest.raises(FitError, match="can be found from this recording"):
        fit_takes([beam.take()], parameters=NAMES, search=QUICK)
    cell = SupportForce((np.nan, np.nan, float(beam_force(beam))), 2e-3)
    tap = Frequencies(hertz, 0.02)
    found = fit_takes([beam.take((cell, tap, Settled(shape, 1e-5)))], parameters=NAMES, search=QUICK)
    for name, true in (("young", 2e5), ("density", 1070.0), ("load.0", 100.0)):
        assert abs(found.values[name] - true) < 3.5 * found.standard_errors[name], name
    assert found.standard_errors["young"] < 0.05 * 2e5
    told = found.takes[0].beside
    assert len(told) == 1 + 2 + 9 and max(abs(each.off) for each in told) < 3
    assert "force on the support, z" in found.summary() and found.status == "converged"
    assert take_as_json(found.takes[0])["beside"][0]["unit"] == "N" and 'id="beside"' in beside_part(found.takes)[1]
    assert set(contributions(found, {"damping": 0.01})[0].shift) == set(NAMES)
    wrong = fit_takes([beam.take((cell, Frequencies(2 * hertz, 0.02)))], parameters=NAMES, search=QUICK)
    said = ("do not agree", "does not follow")  # whichever of the two gives way
    assert any(word in text for text in wrong.warnings for word in said)


def test_a_gauge_is_a_prior(beam):
    one, z = beam.told(Gauge(1.9e5, 1e3, path="young"))
    row, slope = Gaussian(1.9e5, 1e3).row(2e5)
    assert one.rows(z)[0][0] == pytest.approx(row) and one.rows(z)[1][0] == pytest.approx([slope * 2e5, 0.0, 0.0])


def beam_force(beam):
    """The force on the clamp at rest, by the loads alone: all that acts on the free nodes goes through it."""
    rest, _ = jf.equilibrium(beam.model, beam.params, beam.state)
    load = beam.model.loads[0].force(beam.params.loads[0], rest.positions)
    return -WEIGHT + load[:, 2].sum()


@pytest.mark.slow
def test_single_precision_tells_the_same(beam):
    hertz, _ = measured(beam)
    one, z = Beam(jnp.float32).told(Frequencies(hertz, 0.05))
    assert np.abs(one.rows(z)[0]).max() < 0.05 and one.rows(z)[1].dtype == np.float64


@pytest.mark.parametrize(
    ("datum", "message"),
    [
        (Frequencies([5.0, "x"], 0.1), "values of frequencies"),
        (Frequencies([5.0], 0.0), "one positive number in Hz"),
        (Frequencies([5.0, 6.0], 0.1, modes=[1, 1]), "2 different whole numbers"),
        (Frequencies([5.0], 0.1, about="rst"), "about is"),
        (Frequencies([5.0], 0.1, modes=[9999]), "no mode 9999"),
        (Settled({"top": (0, 0, 0)}, 1e-4), 'no marker "top"'),
        (Settled({"tip": (0, 0)}, 1e-4), '"tip" has 2 numbers'),
        (Settled([0, 0, 0], 1e-4), "markers' names"),
        (SupportForce((0, 0), 0.1), "have the shape"),
        (SupportForce((0, 0, 0), 0.1, times=[0.2, 0.1]), "rising times"),
        (SupportForce((0, 0, 0), 0.1, body="bean"), 'no body "bean"'),
        (SupportForce((0, 0, 0), 0.1, box=((1, 1, 1), (2, 2, 2))), "no held node"),
        (Gauge(100.0, 1.0, path="load.1"), 'reads "load.1", which is not fitted'),
        ("a frequency", "give Frequencies, Settled"),
    ],
)
def test_what_cannot_be_told_is_refused_by_name(beam, datum, message):
    with pytest.raises(FitError, match=message):
        data_of([datum], (beam.model, beam.params, beam.state, beam.markers), ["young"], beam.fitted, DT, DT)


def test_a_free_body_has_no_rest_to_tell():
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 1))
    model, params, state = jf.build(jf.Scene([jf.SoftBody(mesh, 2e5, 0.3, 1e3)]))
    with pytest.raises(FitError, match="no held node"):
        data_of([SupportForce((0, 0, 0), 0.1)], (model, params, state, attach(model, PLACES)), [], {}, DT, DT)


def test_tables_of_files_are_read_and_mistakes_named():
    tables = [
        {"kind": "frequencies", "values": [6.2, 7.1], "sigma": 0.05},
        {"kind": "settled", "values": {"tip": [float("nan"), 0.0, -0.004]}, "sigma": 1e-4},
        {"kind": "support_force", "values": [0.0, 0.0, -1.0], "sigma": 0.01, "body": "beam"},
        {"kind": "gauge", "values": 100.0, "sigma": 1.0, "path": "load.0"},
    ]
    found = beside_of(Table({"beside": tables}, "the top level", None), "")
    assert [type(each).__name__ for each in found] == ["Frequencies", "Settled", "SupportForce", "Gauge"]
    for table, message in (
        ({"kind": "frequency", "values": 1.0, "sigma": 1.0}, "did you mean 'frequencies'"),
        ({"kind": "gauge", "values": 1.0}, "missing key 'sigma' in"),
        ({"kind": "gauge", "values": 1.0, "sigma": 1.0, "paht": "a"}, "did you mean 'path'"),
        ({"kind": "settled", "values": 1.0, "sigma": 1.0}, "markers' names"),
        ({"values": 1.0}, "missing key 'kind'"),
    ):
        with pytest.raises(SceneFileError, match=message):
            beside_of(Table({"beside": [table]}, "the top level", None), "take.")


def test_a_load_says_its_own_unit(beam):
    known = placed_constants(beam.model, beam.params, beam.state)
    assert known["load.0"].unit == "Pa"


class Moment(Load, kind="a moment of tests"):
    """A scalar that is no pressure."""

    nodes: object
    total: object
    place, amount, unit, scalar = "nodes", "total", "N m", True

    def resolved(self, body, offset, dtype):
        return _Pushed(jnp.asarray(body.nodes_of("load", self.nodes) + offset, jnp.int32))


class _Pushed(Pytree):
    symmetric: ClassVar[bool] = True
    nodes: jax.Array

    def force(self, value, positions):
        return jnp.zeros_like(positions).at[self.nodes, 2].add(value)

    def reshaped(self, rest):
        return self


def test_scalar_loads_of_ones_own_have_their_unit():
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 1))
    body = jf.SoftBody(mesh, 2e5, 0.3, 1e3, fixed="x-", loads=[Moment("x+", 0.1)])
    model, params, state = jf.build(jf.Scene([body]))
    assert placed_constants(model, params, state)["load.0"].unit == "N m"
