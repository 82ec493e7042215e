"""Does a recording go on, to its end, as the motion of a held body does? By what slow parts of it no swing has.

The markers' motion is split at the period of the swing. What is faster has few shapes, and a body that is held settles,
relaxes and creeps in about these shapes too. What changes slowly in others is no motion of the body: a camera or a rig
that drifts, an axis whose scale changes, a marker that slides on the part. And a swing that nothing drives dies away.
"""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from jaxfem.fitting.frames import rigid_fit
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.release import scatter

SHAPES = 3  # of the swing, at most
WORTH = 0.03  # of the strongest shape: weaker ones are noise, or the drift's own
LEAST = 0.08  # of the swing: a slower change is looked at
EXPLAINED = 0.35  # share of a change that an explanation may leave
ALL_EXPLAINED = 0.2  # one with turn and scale
GRADUAL = (0.08, 0.8)  # share of a swing's energy that a period less of it leaves, where it dies away
ALONE = (0.7, 0.9)  # share of a marker in a shape of several, and in one of its own
TURNS, AWAY = 4, 0.1  # of a swing: so often it is on the other side, by more than a share of its largest
GROWING = 3  # periods
STOPPED = 0.1  # share of its energy that a swing has at most, a period behind its end
SWUNG = 0.3  # of the motion
PERIODS = 4  # of the swing: a shorter recording says nothing of what is slow
FEWEST = 0.6  # share of the rows in which a marker must be seen to be looked at
CLEAR = 4.0  # times the noise's share of a square: what is above it is told well enough
SMOOTHER = (1, 3, 5, 9)  # rows in a mean, to see the swing through the noise
ENDS = 5  # parts of a recording, of which the first and the last are compared
RIGID = 0.05  # of the largest distance of markers on a rigid body
OFF = 5.0  # standard deviations
ASTRAY = 0.3  # of the markers' distances: places farther off do not tell a turn


@dataclasses.dataclass(frozen=True)
class Course:
    """Of markers: the `change` (m, 3) [m] of their slow motion from the first period to the last, less what lies in the
    `shapes` (k, 3 m) of the swing; `span` [m] of the swing, `noise` [m] of the change; `places` (m, 3) [m] on the body,
    and `clamp` (3,) [m], the middle of what is held; `swings`: whether it does so more than once or twice."""

    change: np.ndarray
    shapes: np.ndarray
    span: float
    noise: float
    places: np.ndarray
    clamp: np.ndarray
    swings: bool

    @property
    def least(self) -> float:
        """A change [m] that is worth a word."""
        return max(LEAST * self.span, OFF * self.noise)


def course_faults(
    recording: Recording, nominal: np.ndarray, clamp: np.ndarray, certain: bool
) -> tuple[list[str], list[str]]:
    """(faults, notes) of the rows of a recording that are compared, of a body that is held at `clamp` (3,) and swings;
    `nominal` (M, 3): the markers' given places. Without `certain`, where the body itself may creep, what it may be is a
    note."""
    marks = np.flatnonzero(recording.seen.mean(axis=0) > FEWEST)
    places = filled(recording.positions[:, marks]) if marks.size > 1 and recording.unit != "px" else None
    period = None if places is None else _period(places)
    if places is None or period is None or len(places) < PERIODS * period:
        return [], []
    full = [
        _longest_gap(seen) <= period // 2 for seen in recording.seen[:, marks].T
    ]  # what fills longer ones is no swing
    marks, places = marks[full], places[:, full]
    if marks.size < 2:
        return [], []
    fast = places - _mean(places, period)
    energy = _mean((fast**2).sum(axis=(1, 2))[:, None, None], max(3, period // 2))[:, 0, 0]
    if backwards := _backwards(recording.times, energy, _noise(fast), period):
        return [backwards], []
    first = int(np.argmax(energy > 0.25 * energy.max()))  # about when it was let go
    course = _course(places, first, nominal[marks], clamp, period)
    if course is None or np.linalg.norm(course.change, axis=1).max() < course.least:
        return [], []
    text = _cause(course, [recording.names[k] for k in marks.tolist()])
    if text is None:
        return [], []
    return ([text], []) if certain and course.swings else ([], [f"{text}; or the body creeps"])


def _period(places: np.ndarray) -> int | None:
    """Rows of a period of the swing, about, by its accelerations and velocities; None where it is lost in noise."""
    noise = _noise(places) ** 2
    for rows in SMOOTHER:
        smooth = _mean(places, rows)[rows // 2 : len(places) - rows // 2].reshape(-1, places[0].size)
        if len(smooth) < 6:
            return None
        steps = np.diff(smooth, axis=0)
        steps = steps - np.median(steps, axis=0)
        most = min(max(16, len(steps) // 8), len(steps))  # rows in which it swings most
        first = int(np.argmax(np.convolve((steps**2).sum(axis=1), np.ones(most), "valid")))
        swing = steps[first : first + most]
        along = swing @ np.linalg.svd(swing, full_matrices=False)[2][0]
        v, a = float((along**2).mean()), float((np.diff(along) ** 2).mean())
        v_noise, a_noise = 2 * noise / rows**2, (6 if rows == 1 else 4) * noise / rows**2
        if v > CLEAR * v_noise and a > CLEAR * a_noise:
            return max(4, round(2 * float(np.pi * np.sqrt((v - v_noise) / (a - a_noise)))))
    return None


def _noise(places: np.ndarray) -> float:
    """Scatter of a coordinate [m], root mean square of all."""
    each = [scatter(places[:, m, axis]) for m in range(places.shape[1]) for axis in range(3)]
    return float(np.sqrt(np.mean(np.square(each))))


def _backwards(times: np.ndarray, energy: np.ndarray, noise: float, period: int) -> str | None:
    """A swing that grows for periods and then stops within one: nothing drives it, so time runs backwards."""
    last = int(np.argmax(energy))
    behind = energy[last + period :]
    lags = GROWING if behind.size else 2 * GROWING  # the end of a recording is no stop
    if last < lags * period:
        return None
    levels = energy[last - period * np.arange(lags + 1)]
    shares = levels[1:] / levels[:-1]
    grows = bool(((shares > GRADUAL[0]) & (shares < GRADUAL[1])).all()) and levels[-1] > 4 * noise**2
    earlier = energy[: last - lags * period + 1].max()
    if not grows or earlier > levels[-2] or behind.max(initial=0.0) > STOPPED * levels[0]:
        return None
    return (
        f"the time: the swing grows until {times[last]:.4g} s and then stops, where a body that is let go, and that "
        "nothing drives, swings less and less: the recording runs backwards. Turn the order of its rows"
    )


def _course(places: np.ndarray, first: int, nominal: np.ndarray, clamp: np.ndarray, period: int) -> Course | None:
    """Of places (T, m, 3), let go at about row `first`; None where there is too little of it to say."""
    turn = _turn(np.median(places[: first + 1], axis=0), nominal)
    places = (places[first:] - places[first]) @ turn.T
    if len(places) < (PERIODS - 1) * period:
        return None
    slow = _mean(_mean(places, period), period)
    fast = (places - slow).reshape(len(places), -1)
    shapes = _shapes(fast)
    change = (slow[-period - 1] - slow[period]).ravel()  # nearer to the ends they are no averages
    change = (change - shapes.T @ (shapes @ change)).reshape(-1, 3)
    span, swung = (float(np.linalg.norm(np.ptp(each, axis=0), axis=-1).max()) for each in (places, places - slow))
    swings = _turns(fast @ shapes[0], OFF * _noise(places)) >= TURNS
    if swung < SWUNG * span and not swings:
        return None  # it creeps to where it settles: that is no swing to compare with
    return Course(change, shapes, span, _noise(places) * (6 / period) ** 0.5, nominal, clamp, swings)


def _turns(wave: np.ndarray, least: float) -> int:
    """How often a motion (T,) about its mean is far on one side, by more than `least`, and then far on the other."""
    far = np.sign(wave[np.abs(wave) > max(AWAY * np.abs(wave).max(), least)])
    return int((far[1:] != far[:-1]).sum())


def _shapes(fast: np.ndarray) -> np.ndarray:
    """The strongest shapes (k, 3 m) of fast motion (T, 3 m); not those of one marker alone, where others have more."""
    _, sizes, shapes = np.linalg.svd(fast, full_matrices=False)
    shapes = shapes[:SHAPES][sizes[:SHAPES] > WORTH**0.5 * sizes[0]]
    most = (shapes.reshape(len(shapes), -1, 3) ** 2).sum(axis=-1).max(axis=1)
    return np.asarray(shapes[most < ALONE[1]]) if (most < ALONE[0]).any() else shapes


def _turn(places: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """From the frame of the recording to that of the body, (3, 3); none where places do not tell it."""
    if len(places) < 3:
        return np.eye(3)
    turn, shift = (np.asarray(each) for each in rigid_fit(places, nominal, np.ones(len(nominal))))
    far = np.linalg.norm(nominal - nominal.mean(axis=0), axis=1).max()
    off = np.linalg.norm(places @ turn.T + shift - nominal, axis=1).max()
    return turn if off < ASTRAY * far else np.eye(3)


def _cause(course: Course, names: Sequence[str]) -> str | None:
    """What explains the change: one marker that slides, or all that move together, about the clamp too."""
    count, size = len(names), float(np.linalg.norm(course.change))
    if 3 * count - len(course.shapes) < 5:  # anything would explain it
        return None
    each = np.eye(3)
    alone = [np.kron(np.eye(count)[:, k : k + 1], each) for k in range(count)] if count > 2 else []
    told = [_explained(course, columns) for columns in (*alone, np.tile(each, (count, 1)))]
    k = int(np.argmin([left for left, _ in told]))
    left, own = told[k]
    off = float(np.linalg.norm(own))
    if left < EXPLAINED * size and off > course.least:
        return _slides(names[k], off) if k < len(alone) else _drifts(own)
    arms = course.places - course.clamp
    left, own = _explained(course, _similar(arms))
    if 3 * count - len(course.shapes) < 10 or left > ALL_EXPLAINED * size:
        return None
    if np.linalg.norm(own[:3]) > course.least:
        return _drifts(own[:3])
    return _scales(own[6]) if abs(own[6]) * np.linalg.norm(arms, axis=1).max() > course.least else None


def _explained(course: Course, columns: np.ndarray) -> tuple[float, np.ndarray]:
    """What `columns` (3 m, q), beside the shapes of the swing, leave of the change, and their parts (q,) in it."""
    free = columns - course.shapes.T @ (course.shapes @ columns)
    own = np.linalg.lstsq(free, course.change.ravel(), rcond=1e-6)[0]
    return float(np.linalg.norm(course.change.ravel() - free @ own)), own


def _similar(arms: np.ndarray) -> np.ndarray:
    """How points (m, 3) move by a shift, a turn and a change of scale, (3 m, 7)."""
    turns = [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    return np.stack([*np.tile(np.eye(3), (len(arms), 1)).T, *turns, arms.ravel()], axis=1)


def _slides(name: str, off: float) -> str:
    return (
        f'the marker "{name}" moves by {1e3 * off:.2g} mm in the course of the recording, against the others and not '
        "in their swing: it slides on the part, or sits at another place. Leave it out, or end the recording before "
        "(end = TIME)"
    )


def _drifts(off: np.ndarray) -> str:
    parts = ", ".join(f"{1e3 * value:.2g}" for value in off)
    return (
        f"the camera: in the course of the recording all markers drift by ({parts}) mm along x, y, z, those near the "
        "clamp too, as a body that is held cannot: the camera, the rig or the clamp moves, or a scale changes. Record "
        "again, or give markers on the clamp (clamp = ...), which take it out"
    )


def _scales(share: float) -> str:
    return (
        f"the scale: in the course of the recording all places grow by {100 * share:.2g} % along every axis, as "
        "no body does: the camera's calibration changes. Calibrate, and record again"
    )


def rigid_faults(recording: Recording, carried: Mapping[str, int]) -> list[str]:
    """Markers of one rigid body, `carried` by their numbers, whose distances change in the course of a recording."""
    faults, ends = [], np.array_split(np.arange(len(recording.times)), ENDS)
    if recording.unit == "px" or len(recording.times) < 2 * ENDS:
        return []
    for body in sorted(set(carried.values())):
        names = [name for name, number in carried.items() if number == body]
        if len(names) < 2:
            continue
        places = recording.subset(names).positions
        apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of pairs that are not seen together
            first, last = (np.nanmedian(apart[rows], axis=0) for rows in (ends[0], ends[-1]))
        changed = np.nan_to_num(np.abs(last - first))
        known = filled(places)
        noise = 0.0 if known is None else OFF * _noise(known) * (ENDS / len(places)) ** 0.5 * 2
        if changed.max() <= max(RIGID * float(np.nanmax(first)), noise):
            continue
        of = changed.sum(axis=1)
        worst = int(np.argmax(of))
        share = float(np.nanmean((last / np.where(first > 0, first, np.nan))[~np.eye(len(names), dtype=bool)])) - 1
        alike = len(names) > 2 and np.abs(last - first * (1 + share)).max() < EXPLAINED * changed.max()
        faults.append(_scales(share) if alike else _loosens(names, worst, float(changed.max())))
    return faults


def _loosens(names: Sequence[str], worst: int, off: float) -> str:
    which = f'"{names[worst]}"' if len(names) > 2 else " or ".join(f'"{name}"' for name in names)
    return (
        f"the marker {which}: its distance from the others on the same rigid body changes by {1e3 * off:.2g} mm in the "
        "course of the recording: it slides on the body, or is no longer the same marker. Leave it out, or end the "
        "recording before (end = TIME)"
    )


def filled(places: np.ndarray) -> np.ndarray | None:
    """Places (T, m, 3) with missing ones between their neighbours; None where a marker has none."""
    seen, rows, filled = np.isfinite(places).all(axis=-1), np.arange(len(places)), places.copy()
    if not seen.any(axis=0).all():
        return None
    for marker in range(places.shape[1]):
        there = seen[:, marker]
        for axis in range(3):
            filled[:, marker, axis] = np.interp(rows, rows[there], places[there, marker, axis])
    return filled


def _longest_gap(seen: np.ndarray) -> int:
    """Rows (T,) in a row in which a marker is not seen, at most."""
    return int(np.diff(np.flatnonzero(np.r_[True, seen, True])).max()) - 1


def _mean(values: np.ndarray, rows: int) -> np.ndarray:
    """Means of values (T, m, 3) over about so many rows around each, fewer at the ends, as many before as behind."""
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    at = np.arange(len(values))
    half = np.minimum(np.minimum(at, at[::-1]), rows // 2)
    return np.asarray((total[at + half + 1] - total[at - half]) / (2 * half + 1)[:, None, None])
