"""The clock is checked by how far a body sinks and how fast it rings, a mesh by how far its weight bends it, and a
release that was given by what the markers do around it."""

import types

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, attach, marker_positions, read_recording
from jaxfem.fitting.coarseness import coarse_warnings, stiffened
from jaxfem.fitting.measurement import measurement
from jaxfem.fitting.place_checks import most_turned
from jaxfem.fitting.release import find_release
from jaxfem.fitting.start_checks import release_doubts, release_faults
from jaxfem.fitting.swings import clock_off, swing, swing_faults, swing_warnings

TIMES = np.arange(100) * 0.01
DIRECTIONS = np.array([[0.1, 0.0, -1.0], [0.0, 0.02, -0.5], [0.0, 0.0, -0.1]])
G = 9.81


def sunk(times, rate=45.0, ratio=0.06, begin=0.0):
    """A swing from rest about 9.81 / rate^2, as of a body of one mode that is let go."""
    t, v = np.maximum(times - begin, 0.0), rate * np.sqrt(1 - ratio**2)
    return G / rate**2 * (1 - np.exp(-ratio * rate * t) * (np.cos(v * t) + ratio * rate / v * np.sin(v * t)))


def places(motion, noise=0.0):
    rest = np.zeros((3, 3))
    moved = rest + motion[:, None, None] * DIRECTIONS
    return moved + noise * np.random.default_rng(0).standard_normal(moved.shape)


@pytest.mark.parametrize(("rate", "ratio", "begin"), [(45.0, 0.06, 0.0), (20.0, 0.02, 0.004), (160.0, 0.2, 0.0)])
def test_a_swing_is_told_by_its_mode(rate, ratio, begin):
    motion = sunk(TIMES, rate, ratio, begin)
    noise = 0.01 * motion.max() * np.random.default_rng(1).standard_normal(len(TIMES))
    found = swing(TIMES, motion + noise)
    assert found.rate == pytest.approx(rate, rel=0.01) and found.ratio == pytest.approx(ratio, abs=0.01)
    assert found.sunk == pytest.approx(G / rate**2, rel=0.01)


def test_what_does_not_swing_tells_nothing():
    assert swing(TIMES, np.zeros(100)) is None
    assert swing(TIMES, np.random.default_rng(0).standard_normal(100)) is None
    assert swing(TIMES, 0.01 * (1 - np.exp(-TIMES / 2))) is None  # creeps
    assert swing(TIMES[:6], sunk(TIMES[:6])) is None


@pytest.mark.parametrize("clock", [1.5, 2.0, 0.6, 1.25])
@pytest.mark.parametrize("softer", [1.0, 0.5, 2.0])
def test_a_clock_is_told_whatever_the_stiffness(clock, softer):
    measured, simulated = places(sunk(TIMES / clock), 2e-5), places(sunk(TIMES, 45.0 * softer**0.5, 0.1))
    off = clock_off(simulated, measured, TIMES, 1e-3, 2)
    assert off.clock == pytest.approx(clock, rel=0.02)
    assert f"times are {max(off.clock, 1 / off.clock):.3g} times too {'long' if clock > 1 else 'short'}" in off.words()
    assert clock_off(simulated, places(sunk(TIMES), 2e-5), TIMES, 1e-3, 2) is None


@pytest.mark.parametrize("rows", [3, 5, 9, 15])
def test_places_that_were_smoothed_are_no_clock(rows):
    before = np.arange(-20, 0) * 0.01
    times = np.concatenate([before, TIMES])
    smooth = np.convolve(np.pad(sunk(times), rows // 2, mode="edge"), np.ones(rows) / rows, "valid")[20 - rows // 2 :]
    shown = np.arange(len(smooth)) * 0.01
    assert clock_off(places(sunk(shown)), places(smooth, 1e-5), shown, 1e-3, 2) is None


def test_a_coarse_step_of_backward_euler_may_ring_slower():
    """Where w dt = 0.42 a step turns by atan(0.42): a recording may ring that much faster, its clock right."""
    simulated, measured = places(sunk(TIMES, 42.0)), places(G / 42.0**2 * sunk(TIMES, 42.0 * 1.2) / (G / 50.4**2))
    assert clock_off(simulated, measured, TIMES, 1e-2, 1) is None
    assert clock_off(simulated, measured, TIMES, 1e-3, 1).clock == pytest.approx(1 / 1.2, rel=0.01)


@pytest.mark.parametrize("ratio", [0.5, 0.8, 0.95])
def test_a_start_that_is_damped_too_much_says_nothing_of_the_clock(ratio):
    assert clock_off(places(sunk(TIMES, 45.0, ratio)), places(sunk(TIMES), 2e-5), TIMES, 1e-3, 2) is None


def test_warnings_and_faults_of_a_take():
    simulated, measured = places(sunk(TIMES)), places(sunk(TIMES / 1.5), 2e-5)
    measured[30:33, 1] = np.nan
    take = types.SimpleNamespace(name="swing", unit="m", times=TIMES, simulated=simulated, measured=measured, dt=1e-3)
    (text,) = swing_warnings(take, 2)
    assert text.startswith("swing: markers sink by up to 4.8") and "the rate of the frames" in text
    take.unit = "px"
    assert swing_warnings(take, 2) == []
    seen = np.isfinite(measured[..., 0])
    taken = types.SimpleNamespace(
        positions=np.nan_to_num(measured), seen=seen, origin=np.zeros((3, 3)), times=TIMES, free_origin=False
    )
    assert swing_faults(simulated, taken, 1e-3, 2)[0].startswith("the clock: markers sink")
    assert swing_faults(places(sunk(TIMES, 45.0, 0.1) * 6), taken, 1e-3, 2) == []  # a start that is too far off to say
    taken.positions = places(sunk(TIMES / 1.25))
    taken.seen = np.ones((100, 3), bool)
    assert swing_faults(simulated, taken, 1e-3, 2) == []  # rubber may be as much stiffer when it rings


class Beam:
    """A beam whose start is four times too stiff, and its recording."""

    def __init__(self):
        body = jf.SoftBody(
            jf.mesh.box((0.1, 0.03, 0.03), (4, 2, 2)),
            young=2.6e5,
            poisson=0.4,
            density=1070.0,
            damping=1e-3,
            fixed="x-",
        )
        self.model, self.params, self.state = jf.build(
            jf.Scene([body], gravity=(0.0, 0.0, -G)), scheme="generalized_alpha"
        )
        self.markers = attach(
            self.model, {"tip": (0.1, 0.015, 0.036), "left": (0.1, -0.006, 0.024), "side": (0.05, 0.036, 0.015)}
        )
        states, _ = jf.rollout(self.model, self.params, self.state, 1e-2, 80)
        first = marker_positions(self.markers, self.state.positions)[None]
        moving = np.concatenate([first, marker_positions(self.markers, states.positions)])
        self.places = np.concatenate([np.repeat(first, 20, axis=0), moving])

    def fit(self, clock=1.0, **settings):
        noise = 2e-5 * np.random.default_rng(0).standard_normal(self.places.shape)
        recording = Recording(clock * 1e-2 * np.arange(len(self.places)), self.places + noise, self.markers.names)
        start = self.params.replace(young=1e6)
        return jf.fit(
            self.model, start, self.state, recording, self.markers, parameters=("young", "damping"), dt=1e-2, **settings
        )


@pytest.fixture(scope="module")
def beam():
    return Beam()


@pytest.mark.slow
def test_a_clock_that_is_off_is_refused_in_a_fit_and_told_where_it_goes_on(beam):
    with pytest.raises(FitError, match=r"the clock: markers sink by up to .* times are 1\.\d* times too long"):
        beam.fit(1.5)
    assert any("times are 1.5" in text for text in beam.fit(1.5, checks="warn").warnings)


@pytest.mark.slow
def test_a_release_that_was_given_is_held_against_the_recording(beam):
    with pytest.raises(FitError, match=r"markers move before the release = 0.23 s .* let go at 0.2 s"):
        beam.fit(release=0.23)
    with pytest.raises(FitError, match=r"stand still for \d+ rows behind the release = 0.1 s"):
        beam.fit(release=0.1)
    found = beam.fit(release=0.203)
    assert found.release == pytest.approx(0.2) and found.values["young"] == pytest.approx(2.6e5, rel=0.01)
    assert any("release = 0.203 s lies between rows" in text and "3 ms earlier" in text for text in found.repairs)


def test_a_release_that_was_given_a_row_off_is_told(beam):
    noise = 2e-4 * np.random.default_rng(0).standard_normal(beam.places.shape)
    recording = Recording(1e-2 * np.arange(len(beam.places)), beam.places + noise, beam.markers.names)
    told = {}
    for given in (0.18, 0.19, 0.2):
        taken = measurement(recording, beam.places[0], frame="none", compare="displacement", release=given, end=None)
        told[given] = release_doubts(recording, taken, given)
    assert told[0.2] == [] or "may lie" in told[0.2][0]
    assert all("error bars know nothing of that" in told[given][0] for given in (0.18, 0.19))


@pytest.mark.parametrize("frequency", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("swing", [np.pi, np.pi / 2, 0.2])
@pytest.mark.parametrize("noise", [2e-5, 2e-4])
def test_the_release_of_a_large_slow_arc_is_found(frequency, swing, noise):
    """Along the strongest shape, the chord, what swings on an arc has hardly moved while it is well on its way."""
    times = 0.01 * np.arange(220)
    angle = swing * (1 - np.cos(2 * np.pi * frequency * np.clip(times - 0.2, 0, None))) / 2
    arc = 0.2 * np.stack([np.cos(angle) - 1, 0 * angle, -np.sin(angle)], axis=1)[:, None]
    arc = arc + noise * np.random.default_rng(3).standard_normal(arc.shape)
    found = find_release(Recording(times, arc, ("tip",)))
    assert abs(found.row - 20) <= 1 and found.low - 1 <= 20 <= found.high + 1


def test_a_hand_that_trembles_lets_go_where_it_was_said():
    times = 0.01 * np.arange(120)
    hand = 5e-4 * np.sin(2 * np.pi * 5 * times) * (times < 0.2)
    moved = places(sunk(np.maximum(times - 0.2, 0.0)) + hand, 2e-5)
    recording = Recording(times, moved, ("a", "b", "c"))
    taken = measurement(recording, np.zeros((3, 3)), frame="none", compare="displacement", release=0.2, end=None)
    assert release_faults(recording, taken, 0.2) == []


def test_the_release_of_the_real_recording_is_let_pass(data):
    recording = read_recording(data / "real_beam" / "gravity.csv")
    settings = {"frame": "none", "compare": "displacement", "end": None}
    found = measurement(recording, recording.positions[0], release="auto", **settings)
    taken = measurement(recording, recording.positions[0], release=found.begins[0], **settings)
    assert release_faults(recording, taken, found.begins[0]) == []


def model_of(cells, **more):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=12)
    body = jf.SoftBody(mesh, young=2.6e6, poisson=0.3, density=1070.0, fixed="x-", **more)
    return jf.build(jf.Scene([body], gravity=(0.0, 0.0, -G)))


@pytest.mark.slow
def test_a_coarse_mesh_is_too_stiff_by_what_is_told():
    """What each mesh misses is found from it alone, and how far they sink in equilibrium differs by these factors."""
    scenes = [model_of(cells) for cells in ((3, 1, 1), (6, 2, 2), (12, 4, 4))]
    factors = [stiffened(model, params) for model, params, _ in scenes]
    assert factors == sorted(factors) and 0.3 < factors[0] < 0.5 and 0.8 < factors[2] < 0.95
    sank = []
    for model, params, state in scenes:
        moved = jf.equilibrium(model, params, state)[0].positions - model.rest
        sank.append(-float(np.asarray(moved)[:, 2] @ np.asarray(model.nodal_volumes)))
    assert np.array(sank[:2]) / sank[2] == pytest.approx(np.array(factors[:2]) / factors[2], rel=0.06)
    (text,) = coarse_warnings("take", *model_of((3, 1, 1))[:2], 0.01)
    assert "the mesh is coarse" in text and f"{100 * factors[0]:.0f} % as far" in text
    assert coarse_warnings("take", *model_of((3, 1, 1))[:2], 0.9) == []  # known worse than that


def test_of_other_elements_and_supports_a_mesh_says_nothing():
    assert stiffened(*model_of((3, 1, 1), strain="smoothed")[:2]) == 1.0
    model, params, _ = model_of((3, 1, 1))
    assert stiffened(model, params.replace(gravity=np.zeros(3))) == 1.0
    assert stiffened(model, params.replace(poisson=0.499)) == 1.0  # locks, which has a warning of its own
    assert stiffened(model.replace(free=np.zeros_like(model.free)), params) == 1.0
    along = (np.asarray(model.rest)[:, 0] == 0) & (np.asarray(model.rest)[:, 2] == 0)
    assert stiffened(model.replace(free=np.where(along, 0.0, 1.0)), params) == 1.0  # turns about a line


def test_axes_are_turned_no_more_than_places_say():
    stood = np.random.default_rng(0).normal(size=(6, 3)) * 0.05
    angle = 0.1
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    assert most_turned(stood, stood, "none") < 0.02 and most_turned(stood @ turn.T, stood, "none") > angle
    assert most_turned(stood @ turn.T, stood, "rest") < 0.02
    assert most_turned(0 * stood, stood, "none") == np.inf and most_turned(stood[:2], stood[:2], "none") == np.inf
