"""What is wrong with single samples: codes of lost ones, samples that stick, outliers, names exchanged for a while.

Found by comparison with the same marker's neighbouring samples; what is repaired is said. A sample is never made up:
one that cannot be right becomes a missing one.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jaxfem.fitting.clipped import ends_of_range
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.recording import Recording, rows_in_words

ABSURD = 1e5  # m: no marker stands there
BEYOND_DIGITS = 4.0  # times the smallest change of a coordinate: what is larger is no digit that changed
BEYOND_STILL = 0.02  # of the motion: what moves less from row to row may stand still
SHORT = 4  # rows
STUCK = 3  # rows with the very same place, while it and others move
MANY = 0.2  # share of a marker's samples; beyond, it is not outliers that are wrong
FAR = 12.0  # times the usual scatter
SHARE = 0.3  # of the motion: one smaller outlier moves no value by more than its error bar


def repaired(recording: Recording) -> Recording:
    """The recording with wrong samples missing, exchanged names put right, and notes of both.

    FitError where so many are wrong that it is not samples that are at fault.
    """
    positions, notes = recording.positions.copy(), list(recording.notes)
    flat = recording.unit == "px"  # the third coordinate of pixels is always 0
    for m, name in enumerate(recording.names):
        notes += [f"{name}: {text}" for text in _lost_codes(positions[:, m], recording, flat)]
    notes += _frozen(positions, recording)
    notes += _exchanged(positions, recording)
    moving = _steps(positions)
    for m, name in enumerate(recording.names):
        others = np.delete(moving, m, axis=1)
        notes += [f"{name}: {text}" for text in _stuck(positions[:, m], others, recording)]
    notes += _outliers(positions, recording)
    found = dataclasses.replace(recording, positions=positions)
    return dataclasses.replace(found, notes=(*notes, *ends_of_range(found)))


def first_places(recording: Recording) -> np.ndarray:
    """About where markers stand at first (M, 3), by their first five samples; NaN where there is none."""
    found = np.full(recording.positions.shape[1:], np.nan)
    for m, seen in enumerate(recording.seen.T):
        if (rows := np.flatnonzero(seen)[:5]).size:
            found[m] = np.median(recording.positions[rows, m], axis=0)
    return found


def _lost_codes(places: np.ndarray, recording: Recording, flat: bool) -> Iterator[str]:
    """Samples whose coordinates are one and the same number (0 0 0, 9999 9999 9999) or absurd, away from the others."""
    known = places[:, :2] if flat else places
    seen = np.isfinite(known).all(axis=1)
    absurd = seen & (np.abs(known) > ABSURD).any(axis=1) & (not flat)
    alike = seen & (known == known[:, :1]).all(axis=1)
    good = seen & ~alike & ~absurd
    if good.sum() >= 2:
        middle = np.median(known[good], axis=0)
        reach = np.linalg.norm(known[good] - middle, axis=1)
        away = np.linalg.norm(known - middle, axis=1)
        alike &= (away > 2 * reach.max()) | _off_the_line(known, alike, good)
    else:  # too few others to compare with: only places where nothing ever stands
        alike &= np.zeros_like(alike)
    lost = absurd | alike
    if lost.any():
        code = places[np.argmax(lost)].max()
        places[lost] = np.nan
        yield f"{rows_in_words(lost, recording)}: {code:g} stands for a lost sample, so they are missing"


def _off_the_line(known: np.ndarray, alike: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Which samples with a code lie off the line between the good ones before and after, by more than these differ."""
    rows = np.arange(len(known))
    usual = np.quantile(np.linalg.norm(np.diff(known[good], axis=0), axis=1), 0.9)
    between = np.stack([np.interp(rows, rows[good], known[good, i]) for i in range(known.shape[1])], axis=1)
    return np.asarray(alike & (np.linalg.norm(known - between, axis=1) > 4 * usual))


def _steps(positions: np.ndarray) -> np.ndarray:
    """Distances from row to row (T - 1, M), NaN beside missing samples."""
    return np.asarray(np.linalg.norm(np.diff(positions, axis=0), axis=-1))


def _frozen(positions: np.ndarray, recording: Recording) -> Iterator[str]:
    """Rows in which all markers stand where they stood in the row before, to the last digit, while they move before
    and after: the camera or the export repeated a frame."""
    steps = _steps(positions)
    known = np.isfinite(steps)
    size = np.where(known, steps, 0.0).max(axis=1)
    same = known.any(axis=1) & (size == 0)
    change = np.abs(np.diff(positions, axis=0))
    least = max(BEYOND_DIGITS * change[change > 0].min(initial=np.inf), BEYOND_STILL * _motion(positions))
    noisy = not (change[~same] == 0).any()  # then nothing repeats itself by chance
    lost = np.zeros(len(positions), bool)
    for start, end in _runs(np.concatenate([[False], same])):
        if start < 2:
            continue
        if end >= len(positions):  # to the end: what settles may stand, where numbers have no noise
            lost[start:end] = noisy and end - start >= STUCK and size[start - 2] > least
            continue
        before, after = size[start - 2], size[end - 1]
        if min(before, after) > least and (noisy or end - start <= SHORT or after > 0.5 * (end - start) * before):
            lost[start:end] = True
    if lost.any():
        positions[lost] = np.nan
        rows = rows_in_words(lost, recording)
        yield f"{rows} of all markers repeat the row before while they move, so they are missing"


def _exchanged(positions: np.ndarray, recording: Recording) -> Iterator[str]:
    """Two markers that jump to each other's places and later back: named right again."""
    count = positions.shape[1]
    for a in range(count):
        for b in range(a + 1, count):
            rows = np.flatnonzero(np.isfinite(positions[:, [a, b]]).all(axis=(1, 2)))
            pair = positions[rows][:, [a, b]]  # lost ones may come back exchanged
            straight = np.linalg.norm(pair[1:] - pair[:-1], axis=-1).max(axis=1)
            crossed = np.linalg.norm(pair[1:] - pair[:-1, ::-1], axis=-1).max(axis=1)
            if not straight.size:
                continue
            usual = np.median(straight)
            flips = rows[1:][(straight > 5 * crossed) & (straight > 5 * usual)]
            if not 1 <= len(flips) <= 6:
                continue
            turned = np.cumsum(np.isin(np.arange(len(positions)), flips)) % 2 == 1
            positions[turned, a], positions[turned, b] = positions[turned, b], positions[turned, a]
            names = f"{recording.names[a]} and {recording.names[b]}"
            yield f"{names}: {rows_in_words(turned, recording)}: their names were exchanged, and are put right"


def _stuck(places: np.ndarray, others: np.ndarray, recording: Recording) -> Iterator[str]:
    """Runs of the very same place that end in a leap, while other markers move on: a lost one's last place is kept."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    moved = steps[np.isfinite(steps) & (steps > 0)]
    if not moved.size or not others.size:
        return
    usual = max((float(np.median(each[np.isfinite(each)])) for each in others.T if np.isfinite(each).any()), default=0)
    same = np.concatenate([[False], steps == 0])
    lost = np.zeros(len(places), bool)
    for start, end in _runs(same):
        long = end - start >= STUCK - 1 and end < len(places)
        if long and np.nan_to_num(others[start - 1 : end]).max() > 0.5 * usual and steps[end - 1] > 0:
            if steps[end - 1] > 2 * np.quantile(moved, 0.5) and (others[start - 1 : end] > 0).any(axis=1).all():
                lost[start:end] = True
        elif end == len(places) and STUCK <= end - start and not same[:start].any():  # elsewhere it never repeats
            lost[start:end] = (others[start - 1 : end] > 0).any(axis=1).all()
    if lost.any():
        places[lost] = np.nan
        yield f"{rows_in_words(lost, recording)}: stands at its last place while others move, so they are missing"


def _outliers(positions: np.ndarray, recording: Recording) -> Iterator[str]:
    """Samples that neither what comes before nor what comes after leads to, alone or between two leaps, of one marker
    while the others go on as usual; a leap without return ends the marker's samples."""
    motion, moving = _motion(positions), np.nan_to_num(_steps(positions))
    away = np.stack([_away_of(positions[:, m], recording.times) for m in range(positions.shape[1])], axis=1)
    limits = np.maximum(_usual(away), SHARE * motion)
    slips, sudden = dict[int, int](), _sudden(positions)
    common = (np.nan_to_num(away) > 0.3 * limits).sum(axis=1) > max(1, 0.5 * positions.shape[1])
    for m, name in enumerate(recording.names):
        places = positions[:, m]
        seen = np.isfinite(places).all(axis=1)
        if seen.sum() < 8 or motion == 0:
            continue
        others = np.delete(moving, m, axis=1)
        along = np.zeros(len(places), bool)
        along[1:] = (others > 0.5 * moving[:, m : m + 1]).sum(axis=1) > 0.5 * others.shape[1]
        let_go = np.asarray(np.delete(sudden, m, axis=1).any(axis=1))
        gone, slipped = _leaps(places, recording, motion, common, along, let_go)
        lost = gone | _singles(places, recording, limits[m], seen & ~gone & ~common)
        if lost.sum() > MANY * seen.sum():
            raise FitError(
                f'marker "{name}" leaps in {int(lost.sum())} of its {int(seen.sum())} samples: it is mislabelled '
                "or badly tracked. Clean it in the capture software, or leave the marker out"
            )
        if lost.any():
            places[lost] = np.nan
            yield f"{name}: {rows_in_words(lost, recording)}: far off what comes before and after, so missing"
        if slipped is not None:
            slips[m] = slipped
    for m, row in slips.items():
        if list(slips.values()).count(row) == 1:  # where several leap at once it is the body, let go
            positions[row:, m] = np.nan
            name, when = recording.names[m], recording.times[row]
            yield f"{name}: leaps at {when:g} s and does not come back: missing from then on"


def _usual(away: np.ndarray) -> np.ndarray:
    """How far (M,) samples of markers are off at most, of distances (T, M); 0 for what is hardly ever seen."""
    told = np.isfinite(away).any(axis=0)
    if not told.any():
        return np.zeros(away.shape[1])
    known = away[:, told]
    usual = np.stack([FAR * np.nanmedian(known, axis=0), 3 * np.nanquantile(known, 0.9, axis=0)])
    usual = np.minimum(usual, 5 * np.median(usual, axis=1, keepdims=True))  # none may be much worse than the others
    limits = np.zeros(away.shape[1])
    limits[told] = usual.max(axis=0)
    return limits


def _motion(positions: np.ndarray) -> float:
    """How far a usual marker moves, robustly [m]; of all of them the median."""
    low, high = (np.nanquantile(positions, share, axis=0) for share in (0.02, 0.98))
    return float(np.nanmax([np.nanmedian(np.linalg.norm(high - low, axis=-1)), 0.0]))


def _sudden(positions: np.ndarray) -> np.ndarray:
    """Where markers step much farther than they usually do (T, M), each by its own measure."""
    steps = np.nan_to_num(_steps(positions))
    usual = np.sort(steps, axis=0)[max(0, len(steps) - 5)]
    return np.concatenate([np.zeros_like(steps[:1], bool), steps > 3 * usual])


def _leaps(
    places: np.ndarray,
    recording: Recording,
    motion: float,
    common: np.ndarray,
    along: np.ndarray,
    let_go: np.ndarray,
) -> tuple[np.ndarray, int | None]:
    """Samples between a leap and the leap back (T,), and the row of a leap without return. Where most others go `along`
    (T,) it is the body that moves, and so it is at first where any of them is `let_go` (T,) as suddenly."""
    gone = np.zeros(len(places), bool)
    rows = np.flatnonzero(np.isfinite(places).all(axis=1))
    steps = np.diff(places[rows], axis=0)
    size = np.linalg.norm(steps, axis=1)
    near = np.diff(recording.times[rows]) < 1.5 * recording.spacing
    usual = np.sort(size)[max(0, len(size) - 5)]
    alone = ~common[rows[1:]] & ~common[rows[:-1]] & ~along[rows[1:]]
    leaps = np.flatnonzero(near & (size > 3 * usual) & (size > 0.5 * motion) & alone)
    while leaps.size >= 2:
        first, second = leaps[:2]
        if np.linalg.norm(steps[first] + steps[second]) > 0.3 * size[first]:
            break
        gone[rows[first + 1 : second + 1]] = True
        leaps = leaps[2:]
    if leaps.size == 1 and leaps[0] < SHORT and not let_go[rows[leaps[0] + 1]]:  # the first samples are off
        gone[rows[: leaps[0] + 1]] = True
        leaps = leaps[1:]
    return gone, int(rows[leaps[0] + 1]) if leaps.size == 1 else None


def _singles(places: np.ndarray, recording: Recording, limit: float, trusted: np.ndarray) -> np.ndarray:
    lost = np.zeros(len(places), bool)
    for _ in range(1 + int(MANY * trusted.sum())):
        rows = np.flatnonzero(np.isfinite(places).all(axis=1) & ~lost)
        away = np.where(trusted[rows], _away(places[rows], recording.times[rows]), 0.0)
        worst = int(np.argmax(away))
        if rows.size < 8 or away[worst] <= limit:
            break
        lost[rows[worst]] = True
    return lost


def _away_of(places: np.ndarray, times: np.ndarray) -> np.ndarray:
    away = np.full(len(places), np.nan)
    rows = np.flatnonzero(np.isfinite(places).all(axis=1))
    if rows.size >= 3:
        away[rows] = _away(places[rows], times[rows])
    return away


def _away(places: np.ndarray, times: np.ndarray) -> np.ndarray:
    """How far each sample (n, 3) lies from what its neighbours lead to: lines through the two before, the two after
    and one on each side, the nearest of the three, so that a kink, a blow or a release, is none."""
    n = len(places)
    k = np.arange(n)
    guesses = []
    for one, two in ((-2, -1), (1, 2), (-1, 1)):
        i, j = k + one, k + two
        there = (i >= 0) & (j < n)
        i, j = np.clip(i, 0, n - 1), np.clip(j, 0, n - 1)
        share = (times - times[i]) / np.where(there, times[j] - times[i], 1.0)
        guess = places[i] + share[:, None] * (places[j] - places[i])
        guesses.append(np.where(there, np.linalg.norm(places - guess, axis=1), np.inf))
    return np.asarray(np.min(guesses, axis=0))


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
