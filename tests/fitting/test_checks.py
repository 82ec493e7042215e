"""Bad recordings are refused with their cause, or repaired and told; good ones are left as they are. No simulation."""

import dataclasses

import numpy as np
import pytest

from jaxfem.fitting import FitError, Recording, read_recording
from jaxfem.fitting.before import combinations_in_words, open_faults, refuse
from jaxfem.fitting.clock_checks import jump_faults, pace_faults
from jaxfem.fitting.place_checks import place_faults
from jaxfem.fitting.repairs import repaired
from jaxfem.fitting.unknowns import Unknowns
from jaxfem.materials.constants import DENSITY
from jaxfem.materials.linear import DAMPING, POISSON, YOUNG

NAMES = ("tip", "left", "right", "middle", "side")
PLACES = np.array(
    [[0.1, 0.015, 0.036], [0.1, -0.006, 0.024], [0.1, 0.036, 0.006], [0.05, 0.015, 0.036], [0.02, 0.036, 0.015]]
)
SAG, OMEGA = 4.2e-3, 60.0  # a body that gravity makes swing: SAG OMEGA^2 = 1.5 g
NOISES = [0.0, 2e-5, 2e-4]
STILL = 20


def swing(noise=2e-5, rows=120):
    t = np.maximum(np.arange(rows) - STILL, 0) * 0.01
    z = -SAG * (1 - np.exp(-6 * t) * np.cos(OMEGA * t))
    positions = np.repeat(PLACES[None], rows, axis=0)
    positions[..., 2] += z[:, None] * [1, 0.95, 0.9, 0.3, 0.05]
    positions += noise * np.random.default_rng(0).normal(size=positions.shape)
    return Recording(np.arange(rows) * 0.01, positions, NAMES)


@pytest.mark.parametrize("noise", NOISES)
def test_good_recordings_are_left_alone(noise):
    good = swing(noise)
    again = repaired(good)
    assert again.notes == () and np.array_equal(again.positions, good.positions)
    assert jump_faults(good) == [] and pace_faults(good, 9.81) == []
    for frame, compare in (
        ("none", "displacement"),
        ("none", "position"),
        ("rest", "displacement"),
        ("all", "position"),
    ):
        assert place_faults(good.positions[0], PLACES, NAMES, frame, compare) == ([], [])


def test_the_real_recordings_are_left_alone(data):
    for name in ("gravity", "load52", "load101"):
        recording = read_recording(data / "real_beam" / f"{name}.csv")
        assert repaired(recording).notes == () and jump_faults(recording) == [] and pace_faults(recording, 9.81) == []


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("code", [0.0, 9999.0, -9.999, -1e30, 99.0])
@pytest.mark.parametrize("rows", [slice(35, 40), slice(0, 5), slice(-5, None), slice(60, 61)])
def test_codes_of_lost_samples_become_missing(noise, code, rows):
    recording = swing(noise)
    recording.positions[rows, 1] = code
    again = repaired(recording)
    wrong = np.zeros((120, 5), bool)
    wrong[rows, 1] = True
    assert np.array_equal(again.seen, ~wrong) and "left: " in again.notes[0] and "lost sample" in again.notes[0]


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize(
    ("rows", "off"), [(slice(40, 41), 0.02), (slice(8, 9), -0.02), (slice(45, 48), 0.02), (slice(60, 70), 0.015)]
)
def test_outliers_become_missing(noise, rows, off):
    recording = swing(noise)
    recording.positions[rows, 0, 2] += off
    again = repaired(recording)
    wrong = np.zeros((120, 5), bool)
    wrong[rows, 0] = True
    assert np.array_equal(again.seen, ~wrong) and len(again.notes) == 1


def test_one_lost_coordinate_is_an_outlier():
    recording = swing()
    recording.positions[40:43, 0, 2] = 0
    assert np.flatnonzero(~repaired(recording).seen[:, 0]).tolist() == [40, 41, 42]


@pytest.mark.parametrize("noise", NOISES)
def test_names_exchanged_for_a_while_are_put_right(noise):
    good, recording = swing(noise), swing(noise)
    recording.positions[40:60, [0, 1]] = recording.positions[40:60, [1, 0]]
    again = repaired(recording)
    assert np.array_equal(again.positions, good.positions) and "tip and left" in again.notes[0]


def test_a_marker_that_sticks_or_slips_is_left_out_there():
    recording = swing()
    recording.positions[22:27, 0] = recording.positions[21, 0]
    assert not repaired(recording).seen[22:27, 0].any()
    recording = swing()
    recording.positions[50:, 2, 0] += 0.01
    again = repaired(recording)
    assert not again.seen[50:, 2].any() and again.seen[:50].all() and "does not come back" in again.notes[0]


def test_a_marker_that_only_leaps_is_refused():
    recording = swing()
    recording.positions[::3, 0] += 0.05 * np.random.default_rng(1).normal(size=(40, 3))
    with pytest.raises(FitError, match='"tip" leaps in'):
        repaired(recording)


def test_a_body_that_is_fast_at_first_does_not_slip():
    """It falls by more in the first rows than it moves in all that follow."""
    times = 0.01 * np.arange(30)
    depth = -0.02 * np.minimum(times / 0.02, 1) - 1e-3 * np.sin(40 * times)
    places = np.zeros((30, 3, 3)) + np.array([0.0, 0.01, 0.02])[None, :, None] + depth[:, None, None] * [0, 0, 1]
    places += 2e-5 * np.random.default_rng(0).normal(size=places.shape)
    found = repaired(Recording(times, places, ("a", "b", "c")))
    assert found.seen.all() and not found.notes


def test_blows_are_no_outliers():
    t = np.arange(200) * 0.01
    for noise in (0.0, 1e-4):
        height = np.abs(np.sin(2 * t))[:, None, None] * [0, 0, 1.0]
        bouncing = height + noise * np.random.default_rng(0).normal(size=height.shape)
        assert repaired(Recording(t, bouncing, ("ball",))).notes == ()


@pytest.mark.parametrize("frame", ["none", "rest", "all"])
@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e3), ("cm", 100), ("in", 39.37), ("ft", 3.281)])
def test_units_are_named(frame, unit, scale):
    faults, _ = place_faults(scale * swing().positions[0], PLACES, NAMES, frame, "displacement")
    assert len(faults) == 1 and f"in {unit} instead of m" in faults[0]


@pytest.mark.parametrize("frame", ["none", "rest"])
@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e3), ("cm", 100), ("in", 39.37)])
@pytest.mark.parametrize("which", ["x", "y", "z", "tip", "middle"])
def test_columns_in_another_unit_are_named(frame, unit, scale, which):
    """Of one axis, or of one marker: not a unit of all, nor names exchanged."""
    places = swing().positions[0] if frame == "none" else turned(swing().positions[0])
    columns = (slice(None), "xyz".index(which)) if which in "xyz" else NAMES.index(which)
    places[columns] *= scale
    faults, _ = place_faults(places, PLACES, NAMES, frame, "displacement")
    named = which if which in "xyz" else f'of "{which}"'
    assert len(faults) == 1 and f"columns {named} look to be in {unit} and the others in m" in faults[0], faults


def test_inches_taken_for_cm_are_a_scale():
    faults, _ = place_faults(2.54 * swing().positions[0], PLACES, NAMES, "none", "displacement")
    assert len(faults) == 1 and "2.54 times as far apart" in faults[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirrored_cloud_is_no_exchange_of_names(axis):
    """Two exchanged names explain most of it, and the mirror all."""
    places = {
        "tip": (0.1, 0.015, 0.03),
        "left": (0.1, 0, 0.012),
        "right": (0.1, 0.03, 0.006),
        "mid": (0.05, 0.015, 0.03),
    }
    nominal = np.array([*places.values(), (0.03, 0.03, 0.015)])
    sign = np.ones(3)
    sign[axis] = -1
    told = place_faults(turned(sign * nominal), nominal, NAMES, "rest", "displacement")[0]
    assert len(told) == 1 and "mirrored" in told[0]


def test_displacements_in_another_unit_are_named():
    good = swing(2e-5)
    moved = 1e3 * (good.positions - PLACES)
    first = np.median(moved[:STILL], axis=0)
    assert place_faults(first, PLACES, NAMES, "none", "displacement", float(np.ptp(moved)))[0] == []
    for scale, word in ((1e3, "mm"), (100.0, "cm"), (39.37, "in")):
        told = pace_faults(Recording(good.times, scale * (good.positions - PLACES), NAMES), 9.81)
        assert f"as places in {word} that are taken for m do" in told[0]


def test_the_unit_of_a_single_marker_is_told_by_its_place():
    assert "in mm instead of m" in place_faults(1e3 * PLACES[:1], PLACES[:1], NAMES[:1], "none", "displacement")[0][0]
    assert "no unit explains" in place_faults(7 * PLACES, PLACES, NAMES, "none", "displacement")[0][0]


def turned(points):
    """In a camera's frame."""
    a, b = np.cos(0.7), np.sin(0.7)
    return points @ np.array([[a, -b, 0], [b, a, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, b, -a], [0, a, b]]) + [
        1,
        2,
        3,
    ]


@pytest.mark.parametrize(("i", "j"), [(0, 1), (1, 2), (0, 3), (3, 4)])
def test_exchanged_names_are_named(i, j):
    order = np.arange(5)
    order[[i, j]] = j, i
    places = swing().positions[0, order]
    for frame, seen in (("none", places), ("rest", turned(places)), ("all", turned(places))):
        faults, _ = place_faults(seen, PLACES, NAMES, frame, "displacement")
        assert len(faults) == 1 and f'"{NAMES[i]}" and "{NAMES[j]}" look exchanged' in faults[0]


def test_three_names_exchanged_are_named():
    faults, _ = place_faults(PLACES[[1, 2, 0, 3, 4]], PLACES, NAMES, "none", "displacement")
    assert '"tip" is "left"' in faults[0] and '"right" is "tip"' in faults[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mirrored_axes_are_named(axis):
    sign = np.ones(3)
    sign[axis] = -1
    words = ["-x y z", "x -y z", "x y -z"][axis]
    assert words in place_faults(sign * PLACES, PLACES, NAMES, "none", "displacement")[0][0]
    assert "mirrored" in place_faults(turned(sign * PLACES), PLACES, NAMES, "rest", "displacement")[0][0]


def test_axes_of_another_frame_are_named():
    up = PLACES[:, [1, 2, 0]]
    assert "z x y of the recording" in place_faults(up, PLACES, NAMES, "none", "displacement")[0][0]
    assert 'use frame = "rest"' in place_faults(turned(PLACES), PLACES, NAMES, "none", "displacement")[0][0]
    assert place_faults(turned(PLACES), PLACES, NAMES, "rest", "displacement") == ([], [])


def test_a_wrong_place_is_named():
    places = PLACES + np.array([[0, 0, 0], [0, 0, 0], [0.03, 0, 0.02], [0, 0, 0], [0, 0, 0]])
    assert '"right" most' in place_faults(places, PLACES, NAMES, "rest", "displacement")[0][0]
    slight = PLACES + 5e-3 * np.array([[0, 0, 1], [0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faults, notes = place_faults(slight, PLACES, NAMES, "rest", "displacement")
    assert faults == [] and "differ by" in notes[0]


def test_a_shift_matters_only_to_places():
    moved = PLACES + np.array([0.1, 0.02, -0.03])
    faults, notes = place_faults(moved, PLACES, NAMES, "none", "displacement")
    assert faults == [] and "shifted by 106 mm" in notes[0]
    assert "from its given place" in place_faults(moved, PLACES, NAMES, "none", "position")[0][0]
    assert "displacements" in place_faults(0 * PLACES, PLACES, NAMES, "none", "displacement")[1][0]


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize(
    ("times", "message"),
    [
        (np.arange(120.0), "frame numbers"),
        (np.arange(1, 121.0), "frame numbers"),
        (np.arange(120) * 10.0, "milliseconds"),
        (np.arange(120) * 8.333, "milliseconds"),
        (np.arange(120) * 1e4, "microseconds"),
        (np.arange(120) * 1e7, "not seconds"),
        (np.arange(120) * 1e-5, "faster than a body"),
    ],
)
def test_clocks_that_are_not_seconds_are_named(noise, times, message):
    faults = pace_faults(dataclasses.replace(swing(noise), times=times), 9.81)
    assert len(faults) == 1 and message in faults[0]


def test_frame_numbers_are_named_where_the_loads_say_nothing():
    assert "frame numbers" in pace_faults(dataclasses.replace(swing(), times=np.arange(120.0)), None)[0]
    creep = swing(0.0)
    creep.positions[..., 2] = PLACES[:, 2] - 1e-3 * (1 - np.exp(-np.arange(120.0) / 30))[:, None]
    assert pace_faults(dataclasses.replace(creep, times=np.arange(120.0)), None) == []  # seconds, of a slow creep


def test_a_clock_that_jumps_is_no_gap():
    recording = swing()
    late = recording.times + 10.0 * (np.arange(120) >= 30)
    assert "the clock jumps by 10" in jump_faults(dataclasses.replace(recording, times=late))[0]
    kept = np.delete(np.arange(120), range(28, 48))
    lost = Recording(recording.times[kept], recording.positions[kept], NAMES)
    assert jump_faults(lost) == []


def test_what_cannot_be_told_apart_is_said_in_words():
    both = Unknowns((YOUNG, DENSITY, DAMPING), np.ones(3), np.ones(3))
    random = np.random.default_rng(0)
    young, damping = random.normal(size=(2, 200))
    assert open_faults(np.stack([young, 0.3 * damping + young, damping]), both, 1.0, 1e-16)[0].startswith("only 2 comb")
    told = open_faults(np.stack([young, -young, damping]), both, 1.0, 1e-16)
    assert told[0].startswith("only young/density can be found") and len(told) == 1
    assert "young/density^2 " in open_faults(np.stack([young, -2 * young, damping]), both, 1.0, 1e-16)[0]
    assert "only young*density " in open_faults(np.stack([young, young, damping]), both, 1.0, 1e-16)[0]
    assert open_faults(np.stack([young, 1e-4 * damping - young, damping**2]), both, 1.0, 1e-16) == []
    blind = open_faults(np.stack([young, 1e-17 * young, damping]), both, 1.0, 1e-16)
    assert len(blind) == 1 and blind[0].startswith("density (density)")
    assert "only 1 combination of young, poisson" in combinations_in_words((YOUNG, POISSON), np.array([[1.0, 0.5]]))


def test_faults_are_refused_unless_asked_otherwise():
    assert refuse(["a"], "warn") == ["a"] and refuse([], "refuse") == []
    with pytest.raises(FitError, match=r'a; b.*checks = "warn"'):
        refuse(["a", "b"], "refuse")
