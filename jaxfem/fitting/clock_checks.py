"""Are the times seconds? By the clock's own pattern, and by how fast a body of that weight can move at all."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view as sliding

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.units import LENGTHS
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.release import find_release, motion_along_shape, scatter

JUMP = 5.0  # spacings: a longer pause is looked at
LASTING = 8  # rows with a rate of their own
FAST = 20.0  # times the acceleration of the loads: no stiffness gives more
SLOW = 0.25  # times that acceleration: what is faster from one row to the next does not swing too slowly
CLEAR = 8.0  # times the noise: less is none of a motion
USUAL = 1.2  # of a swing whose unit is right
OVERSHOOT = 1.1  # of the settled displacement: the body swings, so that its inertia is felt


def jump_faults(recording: Recording) -> list[str]:
    """A pause of the clock across which moving markers go on as if nothing had happened."""
    try:
        s = motion_along_shape(recording)
    except FitError:
        return []
    pauses = _pauses(recording)
    noise = scatter(s[np.isfinite(s)])
    for k in pauses:
        around = s[max(0, k - 2) : k + 4]
        if len(around) < 6 or not np.isfinite(around).all():
            continue
        bend = np.abs(np.diff(around, 3)).max()  # of noise alone: sqrt(20) times it
        if np.ptp(around) > 8 * noise and bend < max(0.5 * np.abs(np.diff(around)).max(), 10 * noise):
            return [
                f"the clock jumps by {np.diff(recording.times)[k]:.4g} s after {recording.times[k]:g} s, and the "
                "markers go on as if it were one sample: correct the times, or cut the recording there"
            ]
    return []


def pauses_in_words(recording: Recording) -> list[str]:
    """Where the clock pauses, for the notes."""
    steps = np.diff(recording.times)
    told = [f"no samples for {steps[k]:.3g} s after {recording.times[k]:g} s" for k in _pauses(recording)[:3].tolist()]
    return [*told, *_rates_in_words(recording)]


def _pauses(recording: Recording) -> np.ndarray:
    """Rows after which the clock pauses: for long, and for longer than between the rows around."""
    steps = np.diff(recording.times)
    padded = np.pad(steps, 2, mode="edge")
    around = np.median([padded[k : k + len(steps)] for k in (0, 1, 3, 4)], axis=0)
    return np.flatnonzero((steps > JUMP * recording.spacing) & (steps > 2 * around))


def _rates_in_words(recording: Recording) -> list[str]:
    """Where the rate changes for good, for the notes: samples count with the times that they have."""
    steps = np.diff(recording.times)
    if len(steps) < 4 * LASTING:
        return []
    rows = np.arange(LASTING, len(steps) - LASTING + 1)
    before, after = (np.median(sliding(steps, LASTING)[at], axis=-1) for at in (rows - LASTING, rows))
    change = np.abs(np.log(after / before))
    k = int(np.argmax(change))
    if change[k] < np.log(1.2):
        return []
    return [
        f"the rate changes, from {1 / before[k]:.4g} to {1 / after[k]:.4g} rows a second near "
        f"{recording.times[rows[k]]:.4g} s: samples count with their own times"
    ]


def pace_faults(recording: Recording, load: float | None) -> list[str]:
    """Motion too slow or too fast for a body let go under an acceleration `load` [m/s^2] of its loads; None: unknown.

    A swing of amplitude a at w rad/s accelerates by a w^2, which is about the load whatever the stiffness, since a is
    load over w^2.
    """
    found = _swing(recording)
    if found is None:
        return []
    amplitude, rise, swings, fastest = found
    frequency = 1.55 / rise  # from 15 to 85 % of the way to the first peak, of 1 - cos
    whole = bool(np.allclose(recording.times, np.round(recording.times), atol=1e-9)) and recording.spacing >= 1.0
    if load is None or load == 0:
        return [_slow(recording, None)] if whole and swings else []
    ratio = amplitude * frequency**2 / load
    if ratio > FAST:
        return [
            f"the motion: {2e3 * amplitude:.3g} mm in {rise:.3g} s is {ratio:.3g} times faster than a body of any "
            f"stiffness moves under the scene's loads{_too_far(ratio)}: see the units of places and times, the loads "
            "and the density"
        ]
    return [_slow(recording, ratio)] if ratio < 1 / FAST and swings and fastest < SLOW * load else []


def _too_far(ratio: float) -> str:
    """The unit of places that explains so fast a motion, where one does."""
    for sign in ("mm", "cm", "in"):
        if 0.5 < ratio / USUAL * LENGTHS[sign] < 2:
            return f", as places in {sign} that are taken for m do"
    return ""


def _slow(recording: Recording, ratio: float | None) -> str:
    times = recording.times
    steps = np.diff(times)
    if np.allclose(steps, 1.0, atol=1e-9):
        cause = "its times look like frame numbers: divide them by the rate, or read it with rate=100, say"
    elif 0.9 < recording.spacing < 400 and (ratio is None or 1e-8 < ratio < 1e-4):
        cause = "its times look like milliseconds: call the column time_ms, or divide them by 1000"
    elif ratio is not None and 1e-14 < ratio < 1e-10:
        cause = "its times look like microseconds: call the column time_us, or divide them by 1e6"
    else:
        cause = "its times are not seconds, or the loads, the places' unit or the density are wrong"
    slow = "" if ratio is None else f", {1 / np.sqrt(ratio):.3g} times slower than the scene's loads make a body swing"
    return f"the clock: samples are {recording.spacing:.4g} s apart and the markers swing{slow}: {cause}"


def _swing(recording: Recording) -> tuple[float, float, bool, float] | None:
    """Amplitude of the fastest marker [m], time from 15 to 85 % of its first swing [s], whether it overshoots, and the
    largest acceleration from row to row [m/s^2], noise and all; None where there is no motion but noise."""
    try:
        found = find_release(recording)
    except FitError:
        return None
    s = motion_along_shape(recording)
    known = s[np.isfinite(s)]
    if np.ptp(known) < CLEAR * scatter(known):
        return None
    fastest = float(np.abs(np.diff(known, 2)).max(initial=0.0)) / recording.spacing**2
    after = s[found.row :]
    after = np.abs(after[np.isfinite(after)] - after[np.isfinite(after)][0])
    settled = np.median(after[-max(3, len(after) // 5) :])
    places = recording.positions[found.row :]
    span = np.nanmax(np.linalg.norm(places - np.nanmedian(recording.positions[: found.row + 1], axis=0), axis=-1))
    return 0.5 * float(span), found.rise * recording.spacing, bool(after.max() > OVERSHOOT * settled), fastest
