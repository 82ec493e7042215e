"""Where markers are: places that are known only so well, found with the rest; markers on the clamp, for the frame."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Search, Take, attach, fit_takes
from jaxfem.fitting.clamp import in_frame_of_clamp
from jaxfem.fitting.markers import marker_frames, marker_places, moved_markers, moved_places
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.objective import linearised, residuals
from jaxfem.fitting.recovery import assembled

DT, ROWS = 1e-2, 24
PLACES = {"tip": (0.1, 0.015, 0.036), "left": (0.096, 0.004, 0.011), "middle": (0.04, 0.013, 0.02)}
CLAMP = {"a": (-0.02, 0.0, 0.0), "b": (-0.02, 0.05, 0.0), "c": (-0.02, 0.0, 0.04), "d": (-0.04, 0.02, 0.02)}
QUICK = Search(candidates=1, polish=12, tol=1e-6)


@pytest.fixture(scope="module")
def beam():
    body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1)), 2e5, 0.35, 1070.0, damping=3e-3, fixed="x-")
    return jf.build(jf.Scene([body]), scheme="generalized_alpha")


def recording_of(beam, places, noise=1e-5):
    model, params, state = beam
    markers = attach(model, places)
    states, _ = jf.rollout(model, params, state, DT, ROWS)
    paths = np.concatenate([marker_places(markers, state)[None], marker_places(markers, states)])
    paths = np.concatenate([np.repeat(paths[:1], 6, 0), paths])
    return Recording(
        DT * np.arange(len(paths)), paths + noise * np.random.default_rng(0).normal(size=paths.shape), markers.names
    )


def take_of(beam, recording, **changes):
    model, params, state = beam
    start = params.replace(young=3e5, damping=1e-3)
    return Take(model, start, state, recording, PLACES, DT, release=0.06, **changes)


def test_small_shifts_move_markers_as_new_places_do(beam):
    """Against markers attached at the new places, on a bent beam and on a turned rigid body."""
    ball = jf.RigidBody(jf.Box((0.1, 0.1, 0.1)), mass=1.0, position=(0.5, 0, 0), name="block")
    body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1)), 2e5, 0.35, 1070.0, fixed="x-")
    model, _, state = jf.build(jf.Scene([body, ball]))
    markers = attach(model, {"on": ("block", (0.55, 0.05, 0.0)), **PLACES})
    shifts = 1e-5 * np.random.default_rng(1).normal(size=(4, 3))
    bent = state.positions + 0.1 * jnp.stack(
        [0 * state.positions[:, 0], state.positions[:, 2], state.positions[:, 0]], 1
    )
    turned = state.rigid.replace(orientations=jnp.array([[0.8, 0.0, 0.6, 0.0]]))
    there = state.replace(positions=bent, rigid=turned)
    before = marker_places(markers, there)
    told = before + jnp.einsum("mij,mj->mi", marker_frames(markers, there), shifts)
    np.testing.assert_allclose(marker_places(moved_places(markers, jnp.asarray(shifts)), there), told, atol=1e-12)
    # there feet on the surface are found anew: they stretch with it, which shifts leave out
    np.testing.assert_allclose(marker_places(moved_markers(markers, model, shifts), there), told, atol=2e-6)
    np.testing.assert_allclose(marker_frames(markers, state), np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-12)


@pytest.mark.slow
def test_columns_of_shifts_are_their_derivatives(beam):
    """They are made without a simulation; against differences of the residuals, and with few columns at a time."""
    take = take_of(beam, recording_of(beam, PLACES), compare="position")
    evaluator, _, _ = assembled([take], ("young", "delay"), (), None, None, Noise(), None, "warn", 1e-3)
    piece = evaluator.pieces[0]
    z = jnp.asarray(np.r_[np.log(2.5e5), 1e-3, 1e-3 * np.random.default_rng(0).normal(size=9)])
    r, columns, _ = linearised(z, piece.problem, piece.plan)
    np.testing.assert_allclose(r, residuals(z, piece.problem, piece.plan)[0], atol=1e-12)
    for k in (0, 1, 4, 10):
        step = 1e-5 * jnp.eye(11)[k]
        there, back = (residuals(z + sign * step, piece.problem, piece.plan)[0] for sign in (1, -1))
        np.testing.assert_allclose(columns[k], (there - back) / 2e-5, atol=1e-6 * float(jnp.abs(columns[k]).max()))
    few = linearised(z, piece.problem, dataclasses.replace(piece.plan, at_once=1))
    np.testing.assert_allclose(few[1], columns, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
def test_markers_off_their_places_are_found_with_their_prior(beam):
    """Half a millimetre off: without shifts E is off by many bars, with them within its bar, which is wider."""
    off = {"tip": (0.0995, 0.015, 0.0363), "left": (0.096, 0.0045, 0.011), "middle": (0.0406, 0.013, 0.02)}
    take = take_of(beam, recording_of(beam, off), compare="position")
    plain = fit_takes([take], parameters=("young", "damping"), search=QUICK)
    found = fit_takes([take], parameters=("young", "damping"), search=QUICK, places=5e-4)
    assert len(found.values) == 2 + 9
    assert abs(found.values["young"] - 2e5) < 3 * found.standard_errors["young"] < 0.05 * 2e5
    assert abs(found.values["young"] - 2e5) < abs(plain.values["young"] - 2e5)
    assert found.values["marker.tip.x"] == pytest.approx(-5e-4, abs=4 * found.standard_errors["marker.tip.x"])
    assert found.values["marker.tip.z"] == pytest.approx(3e-4, abs=5e-5)
    assert 0 < found.standard_errors["marker.middle.x"] <= 5.1e-4


def test_a_prior_of_places_is_a_length():
    with pytest.raises(FitError, match="places is -1"):
        from jaxfem.fitting.recovery import _place_prior

        _place_prior(-1)


def turned(recording, noise=1e-5):
    """The recording with clamp markers beside, in a camera's own frame."""
    count = len(recording.times)
    clamp = np.repeat(np.array(list(CLAMP.values()))[None], count, 0)
    clamp = clamp + noise * np.random.default_rng(3).normal(size=clamp.shape)
    angle = 0.7
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    places = np.concatenate([recording.positions, clamp], axis=1) @ turn.T + [1.0, -2.0, 0.3]
    return Recording(recording.times, places, (*recording.names, *CLAMP))


def test_the_clamp_alone_tells_the_frame(beam):
    true = recording_of(beam, PLACES)
    found, notes = in_frame_of_clamp(turned(true), CLAMP, tuple(PLACES), "none")
    np.testing.assert_allclose(found.subset(true.names).positions, true.positions, atol=2e-5)
    assert notes == []
    shaken = turned(true)
    shaken.positions[10:, -4:, 0] += 2e-3
    assert "clamp's markers move by" in str(in_frame_of_clamp(shaken, CLAMP, tuple(PLACES), "none")[1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame": "rest"}, 'frame = "rest": leave one'),
        ({"clamp": {**CLAMP, "tip": (0, 0, 0)}}, '"tip" is named among the markers and on the clamp'),
        ({"clamp": {"a": (0, 0, 0), "b": (0, 1, 0)}}, "three markers"),
        ({"clamp": {**CLAMP, "a": (0, 0)}}, 'place of "a" on the clamp'),
        ({"clamp": {name: [1e3 * x for x in place] for name, place in CLAMP.items()}}, "the unit"),
        ({"clamp": {**CLAMP, "a": CLAMP["b"], "b": CLAMP["a"]}}, '"a" and "b" look exchanged'),
        ({"clamp": {name: (x, y, -z) for name, (x, y, z) in CLAMP.items()}}, "mirrored"),
        ({"clamp": {**CLAMP, "e": (0, 0, 0)}}, 'no marker "e"'),
    ],
)
def test_clamps_that_cannot_be_are_refused(beam, changes, message):
    settings = {"clamp": CLAMP, "frame": "none", **changes}
    recording = turned(recording_of(beam, PLACES))
    with pytest.raises(FitError, match=message):
        in_frame_of_clamp(recording, settings["clamp"], tuple(PLACES), settings["frame"])


@pytest.mark.slow
def test_a_fit_in_the_frame_of_the_clamp(beam):
    recording = turned(recording_of(beam, PLACES))
    found = fit_takes([take_of(beam, recording, clamp=CLAMP)], parameters=("young", "damping"), search=QUICK)
    assert abs(found.values["young"] - 2e5) < 3.5 * found.standard_errors["young"] + 0.003 * 2e5
    assert found.markers == tuple(PLACES)
