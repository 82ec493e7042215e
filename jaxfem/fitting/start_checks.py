"""Does a recording hold one motion from its start, seen by a camera that stands still? By what no body does."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.measurement import Measurement
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.release import find_release, motion_along_shape, scatter

LATE = 3.0  # times the fall within a row; a release that lies a row before is half of it
ALIKE = 0.2  # of a leap: how much markers may differ in it
BACK = 0.05  # of the motion: as near as this is back where it began
TOPS = 3  # times that it is highest
RISES = 0.05  # of its motion: smaller ones are none
AROUND = 2.7  # times the two rows before and behind: of a swing, however sampled, twice at most
LEAP = 0.1  # of the motion: a smaller one is none
JUST_BEFORE = 3  # rows before a release
MOVES, CLEAR = 0.05, 8.0  # of the motion, and times the noise: who is held does not
TREMBLES = 1.5  # times what the hand that holds it moves before that, in as many rows
SUDDEN = 4.0  # times the rows around: a leap is no motion of a body that is held


def late_faults(measured: Measurement, gravity: float | None) -> list[str]:
    """A body that is let go is at rest at first, and then falls by no more than g t^2 / 2: one that moves faster was
    let go before. `gravity` [m/s^2]: what sets it in motion, from rest; None: something else does."""
    both = measured.seen[:2].all(axis=0) if len(measured.times) > 1 else np.zeros(0, bool)
    if not gravity or not both.any():
        return []
    seconds = float(measured.times[1] - measured.times[0])
    steps = np.linalg.norm(measured.positions[1] - measured.positions[0], axis=-1)[both]
    noise = np.sqrt(6) * max(_noise(measured.positions[:, m], measured.seen[:, m]) for m in np.flatnonzero(both))
    fall = 0.5 * gravity * seconds**2
    if steps.max() <= LATE * fall + 2.5 * noise:
        return []
    return [
        f"the release: markers move by {1e3 * steps.max():.3g} mm in the first {seconds:.3g} s, where a body that is "
        f"let go falls by {1e3 * fall:.2g} mm: it moves already. Give release = TIME of the last row in which it is "
        "held; where the recording begins later, record again. Or times run too fast: see their unit and rate"
    ]


def release_doubts(recording: Recording, measured: Measurement, release: float) -> list[str]:
    """A warning of a `release` that was given [s], of a body that is held until then, where the markers say another, or
    do not say it to the row."""
    part, row = _compared(recording, measured)
    try:
        found = find_release(part)
    except FitError:
        return []
    if found.vague or found.low == row == found.high:
        return []
    between = f"from {part.times[found.low]:g} to {part.times[found.high]:g} s"
    if found.low <= row <= found.high:
        return [
            f"release = {release:g} s was given, and by the markers it may lie {between}: error bars know nothing of "
            'that. Fit "delay" too'
        ]
    return [
        f"release = {release:g} s was given, and by the markers it lies {between}: a row puts the stiffness off by "
        'some per cent, and error bars know nothing of that. Give release = "auto", or fit "delay" too'
    ]


def _compared(recording: Recording, measured: Measurement) -> tuple[Recording, int]:
    """The recording up to its last row that is compared, and the row of the release."""
    rows = recording.times <= measured.begins[0] + measured.times[-1] + 0.5 * measured.spacing
    part = dataclasses.replace(recording, times=recording.times[rows], positions=recording.positions[rows])
    return part, int(np.searchsorted(part.times, measured.begins[0] - 0.5 * measured.spacing))


def release_faults(recording: Recording, measured: Measurement, release: float) -> list[str]:
    """A `release` that was given [s], of a body that is held until then: markers move before it, or stand still for
    long behind it."""
    part, row = _compared(recording, measured)
    try:
        s, found = motion_along_shape(part), find_release(part)
    except FitError:
        return []
    before = s[max(0, row - JUST_BEFORE) : row + 1]
    before = before[np.isfinite(before)]
    moved = float(np.ptp(before)) if before.size else 0.0
    earlier = s[: max(0, row - JUST_BEFORE)]
    trembles = max(
        (float(np.ptp(earlier[k : k + len(before)])) for k in range(len(earlier) - len(before) + 1)), default=0.0
    )
    if moved > TREMBLES * trembles and moved > max(
        MOVES * float(np.nanmax(s) - np.nanmin(s)), CLEAR * scatter(s[np.isfinite(s)])
    ):
        since = f": they seem to be let go at {part.times[found.row]:g} s" if found.row < row else ""
        return [
            f"the release: markers move before the release = {release:g} s that was given, by {1e3 * moved:.3g} mm in "
            f'the {len(before)} rows before it{since}. Give the last row in which the body is held, or release = "auto"'
        ]
    if found.vague or found.low - row <= max(2.0, found.rise / 3):
        return []
    return [
        f"the release: markers stand still for {found.row - row} rows behind the release = {release:g} s that was "
        f"given, until {part.times[found.row]:g} s: the simulation would begin without them. Give the last row in "
        'which the body is held, or release = "auto"; or fit "delay"'
    ]


def camera_faults(recording: Recording, held: bool) -> list[str]:
    """All markers leap the same way from one row to the next, as no body does that is held: the camera was knocked."""
    places = recording.positions
    if not held or places.shape[1] < 3 or len(places) < 8 or recording.unit == "px":
        return []
    steps = np.diff(places, axis=0)
    known = np.isfinite(steps).all(axis=-1)
    enough = known.sum(axis=1) >= 3
    usual = np.zeros((len(steps), 3))
    usual[enough] = np.nanmedian(np.where(known[..., None], steps, np.nan)[enough], axis=1)
    size = np.where(enough, np.linalg.norm(usual, axis=1), np.inf)  # rows without say nothing of those beside them
    away = np.where(known, np.linalg.norm(steps - usual[:, None], axis=-1), 0.0).max(axis=1)
    noise = np.sqrt(6) * max(_noise(places[:, m], recording.seen[:, m]) for m in range(places.shape[1]))
    padded = np.pad(size, 2, mode="edge")
    around = np.max([padded[k : k + len(size)] for k in (0, 1, 3, 4)], axis=0)
    leaps = enough & (size > 4 * noise) & (size > SUDDEN * around) & (away < ALIKE * size + 3 * noise)
    rows = np.flatnonzero(leaps[2:-2]) + 2
    if not rows.size:
        return []
    at = int(rows[0])
    return [
        f"the camera: all markers leap by {1e3 * size[at]:.3g} mm, the same way, at {recording.times[at + 1]:g} s, as "
        "a body that is held cannot: the camera or the frame of the recording changed there. End the recording "
        "before it (end = TIME), begin after it, or record again"
    ]


def leap_faults(measured: Measurement, names: Sequence[str]) -> list[str]:
    """A body that is held leaps, in the middle of its motion, to where it cannot be a row later. Rows that are nearer
    to each other, or farther apart, than usual count as if they were not."""
    places, seen = measured.positions, measured.seen
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    apart = np.diff(measured.times)
    known = seen[1:] & seen[:-1] & (apart < 1.5 * measured.spacing)[:, None]
    pace = (np.median(apart) / apart)[:, None]
    each = np.where(known, steps * np.minimum(pace, 1.0), 0.0)
    size = each.max(axis=1, initial=0.0)
    if len(size) < 8:
        return []
    noise = np.sqrt(6) * max(_noise(places[:, m], seen[:, m]) for m in range(places.shape[1]))
    beside = np.where(known, steps * np.maximum(pace, 1.0), 0.0).max(axis=1)
    beside[~known.any(axis=1)] = np.inf  # that says nothing of the rows around
    padded = np.pad(beside, 2, mode="edge")
    around = np.max([padded[k : k + len(size)] for k in (0, 1, 3, 4)], axis=0)
    far = np.linalg.norm(np.ptp(np.where(seen[..., None], places, measured.origin), axis=0), axis=-1).max()
    rows = np.flatnonzero((size > AROUND * around) & (size > 4 * noise) & (size > LEAP * far))
    rows = rows[(rows >= 3) & (rows < len(size) - 3)]  # the first ones are the release
    if not rows.size:
        return []
    when = measured.begins[0] + measured.times[rows[0] + 1]
    leapt = np.flatnonzero(each[rows[0]] > 0.5 * size[rows[0]])
    if leapt.size == 1 and seen.shape[1] > 2:
        return [
            f'the marker "{names[leapt[0]]}" alone leaps by {1e3 * size[rows[0]]:.3g} mm within a row at {when:.4g} s: '
            "it slipped, or is another one from there on. Leave it out, or end before it (end = TIME)"
        ]
    return [
        f"the motion: markers leap by {1e3 * size[rows[0]]:.3g} mm within a row at {when:.4g} s, far more "
        "than in the rows around: two recordings are put together there, or rows are left out. End before it "
        "(end = TIME), or make two of it"
    ]


def bounce_faults(recording: Recording, gravity: np.ndarray) -> list[str]:
    """A body that falls and bounces, and that nothing drives, gets less high each time: where each of several times is
    higher than the last, time runs backwards. `gravity` (3,) [m/s^2] in the frame of the recording."""
    strength = float(np.linalg.norm(gravity))
    seen = recording.seen.all(axis=1)
    if strength == 0 or recording.unit == "px" or seen.sum() < 8:
        return []
    height = (recording.positions[seen].mean(axis=1) @ -gravity) / strength
    least = max(RISES * float(np.ptp(height)), 8 * scatter(height))
    tops, low, high = list[float](), height[0], height[0]
    rising = False
    for value in height:  # tops between which it falls, and rises again, by more than the least
        low, high = min(low, value), max(high, value)
        if not rising and value > low + least:
            rising, high = True, value
        if rising and value < high - least:
            tops.append(high)
            rising, low = False, value
    tops += [high] if rising else []
    higher = np.diff(tops)
    if (higher > 0.5 * least).sum() < TOPS - 1 or higher.min() < -0.25 * least:
        return []
    listed = ", ".join(f"{1e3 * (top - float(height.min())):.3g}" for top in tops[-4:])
    return [
        f"the time: what falls and bounces gets higher each time ({listed} mm), though nothing drives it: the "
        "recording runs backwards. Turn the order of its rows"
    ]


def _noise(places: np.ndarray, seen: np.ndarray) -> float:
    """Scatter of a coordinate of one marker (T, 3) [m]."""
    return max(scatter(places[seen][:, axis]) for axis in range(3)) if seen.any() else 0.0


def again_faults(recording: Recording, measured: Measurement) -> list[str]:
    """Markers that are back where they began, and still, for longer than a swing turns there: let go twice."""
    try:
        found, s = find_release(recording), motion_along_shape(recording)
    except FitError:
        return []
    first = int(np.searchsorted(recording.times, measured.begins[0]))
    after = s[first : first + len(measured.times)]
    start, far = np.nanmedian(s[: first + 1]), np.nanmax(np.abs(after - np.nanmedian(s[: first + 1])))
    near = np.abs(after - start) < BACK * far
    away = np.flatnonzero(np.abs(after - start) > 0.5 * far)
    long = max(6, int(np.ceil(found.rise)))
    for k in range(int(away[0]) if away.size else len(after), len(after) - long):
        if near[k : k + long].all() and np.nanstd(after[k : k + long]) < BACK * far:
            return [
                f"the markers are back where they began, and still, at {recording.times[first + k]:g} s: the body was "
                "held and let go again. End the recording before that (end = TIME), or make two of it"
            ]
    return []
