"""fit recovers what made the recording: exactly from exact data, within its error bars from noisy ones."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Search, attach, marker_positions, recovery
from jaxfem.fitting.evaluation import Near
from jaxfem.fitting.objective import interpolated
from jaxfem.fitting.statistics import ringing_frequency

TRUE = {"young": 2.6e5, "poisson": 0.4, "damping": 2e-3}
DT, STEPS = 1e-2, 60
FAR_OFF = [
    {"young": 30 * 2.6e5, "poisson": 0.1, "damping": 2e-2},
    {"young": 2.6e5 / 30, "poisson": 0.48, "damping": 2e-4},
]
PLACES = {
    "tip": (0.1, 0.015, 0.036),
    "left": (0.1, -0.006, 0.024),
    "right": (0.1, 0.036, 0.006),
    "middle": (0.05, 0.015, 0.036),
    "side": (0.02, 0.036, 0.015),
}


class Beam:
    """A coarse beam with markers and its exact motion."""

    def __init__(self):
        mesh = jf.mesh.box((0.1, 0.03, 0.03), cells=(4, 2, 2))
        body = jf.SoftBody(mesh, density=1070.0, fixed="x-", **TRUE)
        self.model, self.params, self.state = jf.build(jf.Scene([body]))
        self.markers = attach(self.model, PLACES)
        states, _ = jf.rollout(self.model, self.params, self.state, DT, STEPS)
        first = marker_positions(self.markers, self.state.positions)[None]
        self.clean = np.concatenate([first, marker_positions(self.markers, states.positions)])
        self.largest = np.abs(self.clean - self.clean[0]).max()

    def recording(self, noise=0.0, still=30, seed=0):
        positions = np.concatenate([np.repeat(self.clean[:1], still, axis=0), self.clean])
        positions = positions + noise * self.largest * np.random.default_rng(seed).normal(size=positions.shape)
        return Recording(np.arange(len(positions)) * DT, positions, tuple(PLACES))

    def fit(self, recording, start, **settings):
        params = self.params.replace(**{name: jnp.asarray(value) for name, value in start.items()})
        return jf.fit(self.model, params, self.state, recording, self.markers, dt=DT, **settings)


@pytest.fixture(scope="module")
def beam():
    return Beam()


def errors(result):
    return {name: abs(value / TRUE[name] - 1) for name, value in result.values.items()}


@pytest.mark.parametrize(
    ("start", "corrected"), [(FAR_OFF[0], False), (FAR_OFF[1], True)], ids=["stiff", "soft, derivatives corrected"]
)
def test_exact_data_give_exact_values_from_far_off(beam, start, corrected, monkeypatch):
    if corrected:  # as where simulations take longer than compiling
        monkeypatch.setattr("jaxfem.fitting.engines.SHORT", 0)
    result = beam.fit(beam.recording(), start)  # released after row 30, which is found
    assert result.release == pytest.approx(0.3) and max(errors(result).values()) < 1e-5
    assert result.status == "converged" and result.noise < 1e-9 and result.iterations <= (7 if corrected else 10)
    assert float(result.params.young) == pytest.approx(result.values["young"])
    assert any("omega dt / 2" in text for text in result.warnings)  # the step damps five times more than the material


@pytest.mark.slow
@pytest.mark.parametrize("start", FAR_OFF, ids=["stiff", "soft"])
def test_noisy_data_give_values_within_their_error_bars(beam, start):
    # 1 % of the largest displacement: young and poisson to 3 %; damping to what 10 ms steps, five times it, leave of it
    result = beam.fit(beam.recording(noise=0.01, seed=3), start, release=0.3)
    off = errors(result)
    assert off["young"] < 0.03 and off["poisson"] < 0.03 and off["damping"] < 0.15
    for name, value in result.values.items():
        assert abs(value - TRUE[name]) < 3.5 * result.standard_errors[name] < 0.5 * TRUE[name]
    assert result.noise == pytest.approx(0.01 * beam.largest, rel=0.1)


@pytest.mark.slow
def test_missing_samples_and_an_unknown_camera(beam):
    recording = beam.recording()
    positions = recording.positions
    positions[np.random.default_rng(4).random(positions.shape[:2]) < 0.15] = np.nan
    positions[50:, 3] = np.nan  # a marker that falls off
    rotation = np.asarray(jf.rotation.rotation_vector_to_matrix(jnp.array([0.5, -2.0, 1.0])))
    moved = Recording(recording.times, positions @ rotation.T + [0.2, 1.0, -3.0], recording.names)
    for frame, compare in (("rest", "displacement"), ("all", "position")):
        result = beam.fit(moved, FAR_OFF[1], frame=frame, compare=compare, release=0.3)
        assert max(errors(result).values()) < 1e-3, frame
        assert np.isnan(result.residuals).any() and result.release == pytest.approx(0.3)


@pytest.mark.slow
def test_a_marker_that_is_behind_the_others_is_named(beam):
    recording = beam.recording(noise=0.005, seed=1)
    positions = recording.positions
    positions[3:, 0] = positions[:-3, 0]
    result = beam.fit(Recording(recording.times, positions, recording.names), FAR_OFF[1], release=0.3)
    (told,) = [text for text in result.warnings if "what is left looks as if" in text]
    assert f"{recording.names[0]} is 0.03" in told and "behind the others" in told


@pytest.mark.slow
def test_bars_know_of_the_rest_where_the_frame_is_found_with_the_fit(beam):
    """Displacements share the error of the place they start from, in any frame: bars were a third of the scatter."""
    recording = beam.recording(noise=0.01, seed=3)
    bars = [beam.fit(recording, {}, frame=frame, release=0.3).standard_errors["damping"] for frame in ("rest", "all")]
    assert bars[1] == pytest.approx(bars[0], rel=0.3)


def test_derivatives_are_corrected_by_what_a_step_found():
    """A step's change is told by them from then on; what lies across the step, measured by its size, is as it was."""
    random = np.random.default_rng(0)
    jacobian, old, new = random.normal(size=(3, 4, 2, 3)), *random.normal(size=(2, 4, 2, 3))
    step = np.array([0.1, -0.3, 0.2])
    near = Near(np.ones(3), [old], [jacobian], True).stepped(1 + step, [new])
    assert not near.made and np.allclose(np.tensordot(step, near.jacobian[0], 1), new - old, atol=1e-14)
    across = np.cross(step * (jacobian**2).sum(axis=(1, 2, 3)), [1.0, 0.0, 0.0])
    assert np.allclose(np.tensordot(across, near.jacobian[0] - jacobian, 1), 0, atol=1e-13)


def test_progress_is_told(beam):
    told = []
    result = beam.fit(beam.recording(), {"damping": 1e-3}, progress=lambda *each: told.append(each))
    assert len(told) == len(result.history) and told[0][0] == "scan" and set(told[0][3]) == set(TRUE)


def test_an_interruption_keeps_the_best(beam):
    def stop(stage, iteration, loss, values):
        if iteration == 9:
            raise KeyboardInterrupt

    result = beam.fit(beam.recording(), FAR_OFF[0], progress=stop)
    assert result.status == "interrupted"
    assert 0.3 < result.values["young"] / TRUE["young"] < 3


@pytest.mark.parametrize("stage", ["judged", "with_limits"])
def test_an_interruption_behind_the_search_keeps_what_it_found(beam, stage, monkeypatch):
    usual, calls = getattr(recovery, stage), []

    def stopped(*given):
        calls.append(given)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return usual(*given)

    monkeypatch.setattr(recovery, stage, stopped)
    result = beam.fit(beam.recording(), {})
    assert result.status == "interrupted" and result.values == pytest.approx(TRUE, rel=1e-3)


@pytest.mark.slow
def test_an_interruption_of_drawn_starts_keeps_the_best_of_all(beam):
    def stop(stage, iteration, loss, values):
        if stage == "starts":
            raise KeyboardInterrupt

    result = beam.fit(beam.recording(), {}, progress=stop, multi_start=3, engine="vmap")
    assert result.status == "interrupted" and result.values == pytest.approx(TRUE, rel=1e-3)


def test_an_end_at_a_bound_is_said(beam):
    result = beam.fit(beam.recording(), {}, bounds={"young": (3e5, 1e6)})
    assert any("young ended at its lower bound" in text for text in result.warnings)
    assert "young" in result.summary()


@pytest.mark.slow
def test_bad_recordings_are_refused_before_the_search(beam):
    """One linearised simulation shows what places and clock do not; `progress` tells of each simulation of a search."""

    def none_asked_for(*visit):
        raise AssertionError("a search was begun")

    def refused(recording, message, **settings):
        with pytest.raises(FitError, match=message):
            beam.fit(recording, FAR_OFF[0], progress=none_asked_for, **settings)

    good = beam.recording()
    first = good.positions[:1]
    displaced = good.positions - first
    refused(Recording(good.times, 1e3 * good.positions, good.names), "in mm instead of m")
    refused(Recording(100 * good.times, good.positions, good.names), "frame numbers")
    refused(Recording(good.times, first - displaced, good.names), "the markers move against .* turn the sign")
    opposed = displaced * np.where(np.arange(5) == 0, -1, 1)[:, None]
    refused(Recording(good.times, first + opposed, good.names), '"tip" moves against')
    refused(good, "the start of young, 1e.07, is outside", bounds={"young": (1e4, 1e6)}, starts=[{"young": 1e7}])


@pytest.mark.slow
def test_pixels_of_one_camera_give_the_stiffness(beam):
    """A camera half a metre aside that looks along y; 0.3 px of noise on a swing of about 11 px."""
    sharp, turn = (
        np.array([[1500.0, 0, 640], [0, 1500, 360], [0, 0, 1]]),
        np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    )
    camera = sharp @ np.hstack([turn, -turn @ [[0.05], [-0.5], [0.02]]])
    good = beam.recording()
    seen = good.positions @ camera[:, :3].T + camera[:, 3]
    places = np.concatenate([seen[..., :2] / seen[..., 2:], 0 * seen[..., :1]], axis=-1)
    places += np.random.default_rng(0).normal(size=places.shape) * [0.3, 0.3, 0]
    film = Recording(good.times, places, good.names, unit="px", camera=camera)
    settings = {"parameters": ("young", "damping"), "release": 0.3}
    result = beam.fit(film, {"young": 2e6}, **settings)
    off = abs(result.values["young"] - TRUE["young"])
    assert off < 3.5 * result.standard_errors["young"] < 0.1 * TRUE["young"]
    assert result.unit == "px" and result.noise == pytest.approx(0.3, rel=0.1) and " px rms" in result.summary()
    upside_down = Recording(good.times, places * [1, -1, 1] + [0, 720, 0], good.names, unit="px", camera=camera)
    with pytest.raises(FitError, match="v points down"):
        beam.fit(upside_down, {}, **settings)
    with pytest.raises(FitError, match="needs places"):
        beam.fit(film, {}, frame="rest", **settings)
    with pytest.raises(FitError, match="give its camera"):
        beam.fit(Recording(good.times, places, good.names, unit="px"), {}, **settings)


@pytest.mark.slow
def test_what_was_repaired_is_said_and_does_no_harm(beam):
    recording = beam.recording()
    recording.positions[40:45, 0] = 0.0
    recording.positions[60, 1, 2] += 0.05
    result = beam.fit(recording, {}, release=0.3)
    assert max(errors(result).values()) < 1e-4
    assert "tip: 5 samples from 0.4 s on" in result.repairs[0] and "left: 1 sample" in result.repairs[1]
    assert "recording: tip" in result.summary()


@pytest.mark.slow
def test_optax_descent_may_come_first(beam):
    result = beam.fit(beam.recording(), FAR_OFF[1], search=Search(candidates=1, descent=4))
    assert max(errors(result).values()) < 1e-5


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"parameters": ()}, "no parameter"),
        ({"parameters": ("stiffness",)}, 'cannot fit "stiffness"; known: young'),
        ({"bounds": {"density": (1, 2)}}, '"density", which is not fitted'),
        ({"bounds": {"poisson": (0.3, 0.6)}}, "between -1 and 0.5"),
        ({"starts": [{"young": -1.0}]}, "must be positive"),
        ({"sigma": -1.0}, "sigma is -1.0"),
    ],
)
def test_impossible_settings_are_refused(beam, settings, message):
    with pytest.raises(FitError, match=message):
        beam.fit(beam.recording(), {}, **settings)


def test_interpolation_is_exact_on_samples_and_third_order_between():
    def error(h):
        t = np.arange(0, 1 + h / 2, h)
        places = np.linspace(0.2, 0.8, 57)
        return np.abs(interpolated(jnp.sin(3 * jnp.asarray(t)), jnp.asarray(places / h)) - np.sin(3 * places)).max()

    frames = jnp.asarray(np.random.default_rng(0).normal(size=(6, 2, 3)))
    np.testing.assert_allclose(interpolated(frames, jnp.arange(6.0)), frames, atol=1e-14)
    np.testing.assert_allclose(interpolated(frames, jnp.array([-3.0, 9.0])), frames[jnp.array([0, 5])], atol=1e-14)
    assert error(0.05) / error(0.025) > 2**2.5


def test_the_ringing_frequency_is_found():
    t = np.arange(0, 1.5, 0.01)
    motion = (1 - np.exp(-3 * t) * np.cos(2 * np.pi * 7.7 * t))[:, None, None] * np.ones((1, 2, 3))
    assert ringing_frequency(t, motion) == pytest.approx(7.7, rel=0.03)
