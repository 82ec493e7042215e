"""What goes wrong slowly, or as a whole, in recordings: drifts, scales, markers that slide, time that runs backwards,
takes put together. Named by what no body that is held does; what swings, beats, relaxes or creeps is let pass. No
simulation."""

import dataclasses

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Take, read_recording
from jaxfem.fitting.course_checks import course_faults, rigid_faults
from jaxfem.fitting.measurement import measurement
from jaxfem.fitting.repairs import repaired
from jaxfem.fitting.start_checks import bounce_faults, leap_faults
from jaxfem.fitting.takes import prepared

NAMES = ("tip", "left", "right", "middle", "side")
PLACES = np.array(
    [[0.1, 0.015, 0.036], [0.1, -0.006, 0.024], [0.1, 0.036, 0.006], [0.05, 0.015, 0.036], [0.02, 0.036, 0.015]]
)
CLAMP, STILL, RATE = np.array([0.0, 0.015, 0.015]), 20, 100
ALONG = PLACES[:, 0] / 0.1
BENT, BENT_AGAIN = ALONG**2 * (1.5 - 0.5 * ALONG), ALONG**2 * (ALONG - 0.8) * 4


def swing(noise=2e-5, rows=150, w=45.0, ratio=0.08, size=4e-3, creep=0.0, beat=0.0, seed=0):
    """A beam let go: a swing of w rad/s, its second mode, one across of nearly the same rate, and what it creeps."""
    t = np.maximum(np.arange(rows) - STILL, 0) / RATE

    def let_go(w):
        return 1 - np.exp(-ratio * w * t) * np.cos(w * t)

    down = np.outer(let_go(w) * (1 + creep * (1 - np.exp(-2 * t))), BENT) + 0.05 * np.outer(let_go(5 * w), BENT_AGAIN)
    places = np.repeat(PLACES[None], rows, axis=0)
    places[..., 2] -= size * down
    places[..., 1] += size * beat * np.outer(let_go(1.15 * w), BENT)
    places[..., 0] -= 0.6 / 0.1 * size**2 * down**2  # it gets shorter
    return Recording(
        np.arange(rows) / RATE, places + noise * np.random.default_rng(seed).normal(size=places.shape), NAMES
    )


def told(recording, certain=True):
    return course_faults(recording, PLACES, CLAMP, certain)


def changed(recording, change):
    """With places (T, M, 3) + change(share of the time)."""
    share = np.linspace(0, 1, len(recording.times))[:, None, None]
    return dataclasses.replace(recording, positions=recording.positions + change(share))


GOOD = {
    "usual": {},
    "slow": {"w": 15.0},
    "without damping": {"ratio": 1e-3},
    "much damping": {"ratio": 0.4},
    "none of a swing": {"ratio": 2.0},
    "creeps": {"creep": 0.5},
    "beats": {"beat": 0.8, "ratio": 3e-3, "rows": 400},
    "far": {"size": 0.03},
    "short": {"rows": 40},
}


@pytest.mark.parametrize("noise", [0.0, 2e-5, 2e-4])
@pytest.mark.parametrize("which", GOOD)
def test_what_a_body_does_is_let_pass(noise, which):
    for seed in range(5):
        assert told(swing(noise, seed=seed, **GOOD[which])) == ([], [])


def test_the_real_recordings_are_let_pass_and_their_copies_named(data):
    base = [[0.006, -0.01, -0.001], [0.006, 0.04, 0.0275], [0.006, 0.04, 0.0]]
    places = np.array([[0.1, 0.015, 0.036], [0.1, -0.006, 0.024], [0.1, 0.036, 0.006], *base])
    for name in ("gravity", "load52", "load101"):
        recording = read_recording(data / "real_beam" / f"{name}.csv")
        assert course_faults(recording, places, CLAMP, True) == ([], [])
        for axis in range(3):
            off = changed(recording, lambda share, axis=axis: 5e-3 * share * np.eye(3)[axis])
            assert "drift" in course_faults(off, places, CLAMP, True)[0][0], (name, axis)
        for marker in range(6):
            off = changed(recording, lambda share, m=marker: share * 0.01 * np.eye(6)[m][:, None] * [0.6, 0.8, 0])
            assert f'"{recording.names[marker]}" moves' in course_faults(off, places, CLAMP, True)[0][0]


@pytest.mark.parametrize("noise", [0.0, 2e-5, 2e-4])
@pytest.mark.parametrize("size", [2e-3, 4e-3])
def test_drifts_scales_and_markers_that_slide_are_named(noise, size):
    good = swing(noise, size=size)
    for axis in range(3):
        for course in (lambda share: share, lambda share: share**2):
            faults = told(changed(good, lambda share, axis=axis, c=course: 5e-3 * c(share) * np.eye(3)[axis]))[0]
            assert len(faults) == 1 and "the camera" in faults[0] and "drift" in faults[0]
    far = changed(good, lambda share: 0.01 * share * (good.positions - [1.0, 0.5, -1.0]))
    near = changed(good, lambda share: 0.05 * share * (good.positions - CLAMP))
    assert "the camera" in told(far)[0][0] and ("scale" in told(near)[0][0] or "camera" in told(near)[0][0])
    for marker, name in enumerate(NAMES):
        for course in (lambda share: share, lambda share: 1 / (1 + np.exp(-40 * (share - 0.6)))):
            off = np.eye(5)[marker][:, None] * [6e-3, 8e-3, 0.0]
            faults = told(changed(good, lambda share, off=off, c=course: c(share) * off))[0]
            assert len(faults) == 1 and f'"{name}" moves' in faults[0]


def test_where_the_body_may_creep_it_is_a_note():
    faults, notes = told(changed(swing(), lambda share: 5e-3 * share * np.eye(3)[1]), certain=False)
    assert faults == [] and "or the body creeps" in notes[0]


@pytest.mark.parametrize("noise", [0.0, 2e-5, 2e-4])
@pytest.mark.parametrize("kind", ["usual", "creeps", "far"])
def test_a_recording_played_backwards_is_named(noise, kind):
    good = swing(noise, **GOOD[kind])
    back = dataclasses.replace(good, positions=good.positions[::-1])
    assert "runs backwards" in told(back)[0][0]


@pytest.mark.parametrize("noise", [0.0, 2e-5, 1e-4])
def test_two_takes_put_together_are_named(noise):
    one, other = swing(noise), swing(noise, seed=1)
    cut = {"release": STILL / RATE, "end": None, "frame": "none", "compare": "displacement"}
    assert leap_faults(measurement(one, PLACES, **cut), NAMES) == []
    for until, since in ((150, STILL), (60, STILL), (100, STILL + 7)):
        rows = np.concatenate([one.positions[:until], other.positions[since:]])
        both = Recording(np.arange(len(rows)) / RATE, rows, NAMES)
        faults = leap_faults(measurement(both, PLACES, **cut), NAMES)
        assert len(faults) == 1 and f"at {until / RATE:g} s" in faults[0] and "put together" in faults[0]


def test_names_exchanged_while_markers_were_lost_are_put_right():
    good, wrong = swing(), swing()
    wrong.positions[60:, [0, 1]] = wrong.positions[60:, [1, 0]]
    wrong.positions[50:60, :2] = np.nan
    again = repaired(wrong)
    assert np.array_equal(again.positions[60:], good.positions[60:]) and "exchanged" in again.notes[0]


def test_markers_of_a_rigid_body_keep_their_distances():
    t = np.arange(120) / RATE
    turns = np.stack([jf.rotation.rotation_vector_to_matrix(np.array([0, 0, 3 * s])) for s in t])
    arms = 0.05 * np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    names = ("a", "b", "c", "d")
    fallen = 1 - 4.9 * t[:, None, None] ** 2
    places = np.einsum("tij,mj->tmi", turns, arms) + fallen * np.eye(3)[2]
    places += 1e-4 * np.random.default_rng(0).normal(size=places.shape)
    good, on = Recording(t, places, names), dict.fromkeys(names, 0)
    assert rigid_faults(good, on) == [] and rigid_faults(good, {}) == []
    assert rigid_faults(changed(good, lambda share: 0.1 * share), on) == []
    slid = changed(good, lambda share: share * np.eye(4)[1][:, None] * [0.0, 0.0, 0.02])
    assert '"b"' in rigid_faults(slid, on)[0]
    assert "the scale" in rigid_faults(changed(good, lambda share: 0.1 * share * good.positions), on)[0]


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_ball_that_bounces_higher_each_time_is_named(noise):
    heights, speed, height = [], 0.0, 0.2
    for _ in range(200):
        speed, height = speed - 9.81 / RATE, height + speed / RATE
        if height < 0:
            speed, height = -0.7 * speed, -height
        heights.append(height)
    places = np.array(heights)[:, None, None] * np.eye(3)[2] + [0, 0, 0.01]
    places = places + noise * np.random.default_rng(0).normal(size=places.shape)
    ball, down = Recording(np.arange(200) / RATE, places, ("ball",)), np.array([0, 0, -9.81])
    assert bounce_faults(ball, down) == [] and repaired(ball).notes == ()
    back = dataclasses.replace(ball, positions=places[::-1])
    assert "higher each time" in bounce_faults(back, down)[0] and bounce_faults(back, 0 * down) == []


def test_what_is_wrong_is_said_before_the_search():
    body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 1)), 2e5, 0.3, 1e3, fixed="x-", name="beam")
    scene = jf.build(jf.Scene([body]))
    places = dict(zip(NAMES, PLACES, strict=True))
    good = swing()
    assert prepared(Take(*scene, good, places, 0.01), "refuse", True).faults == ()
    off = changed(good, lambda share: 5e-3 * share * np.eye(3)[1])
    with pytest.raises(FitError, match=r"the camera: .* drift"):
        prepared(Take(*scene, off, places, 0.01), "refuse", True)
    assert len(prepared(Take(*scene, off, places, 0.01), "warn", True).faults) == 1
    early = Take(*scene, changed(good, lambda share: 0.02 * np.maximum(share - 0.85, 0)), places, 0.01, end=1.2)
    assert prepared(early, "refuse", True).faults == ()  # what is wrong behind the end does not matter
    back = dataclasses.replace(good, positions=good.positions[::-1])
    with pytest.raises(FitError, match="backwards"):  # not that the release cannot be told
        prepared(Take(*scene, back, places, 0.01), "refuse", True)


def test_a_gap_at_the_release_is_no_marker_that_slides():
    recording = swing()
    recording.positions[STILL - 5 : STILL + 10, 0] = np.nan
    assert told(recording) == ([], [])


def test_one_marker_that_leaps_is_named():
    recording = swing()
    recording.positions[100:, 2, 0] += 2e-3
    cut = {"release": STILL / RATE, "end": None, "frame": "none", "compare": "displacement"}
    assert '"right" alone leaps' in leap_faults(measurement(recording, PLACES, **cut), NAMES)[0]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seen", [1, 2, 5, 9])
def test_a_marker_that_is_hardly_ever_seen_says_nothing_of_the_others(seen):
    recording = swing()
    recording.positions[seen:, 0] = np.nan
    again = repaired(recording)
    assert again.notes == () and np.array_equal(again.seen, recording.seen)
