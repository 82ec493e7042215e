"""When a body is let go, and when it has settled: a change point found by its likelihood, with an interval.

The markers' early motion has one shape; along it their places are one number a row, s, in which many noisy markers make
one quiet signal. Still until row r and then s = a sin(w k) + b (1 - cos(w k)) with a, b >= 0 in k rows after it, up to
its first peak: a start by acceleration, as of a body let go, and one by velocity, as first-order time steps or a blow
make it. That shape is off by a share of the motion, so that rows count by the noise and by how far they are. The noise
is known but for a factor: row r has the likelihood SSR^(-n/2), summed over w (Hinkley 1970; Box & Tiao 1973, ch. 2).
"""

import dataclasses

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.recording import Recording

FEW = 3  # still rows; with fewer, places before the release are no better known than any other
BEFORE = 30  # rows before the rise that tell the noise; more, where the rise is slow
COVERED = 0.95  # of the posterior inside the interval
EVIDENCE = 8.0  # log likelihood by which a release must beat noise alone
SETTLED = 0.05  # share of the largest excursion within which a body counts as settled
EARLY, ALONG = 0.2, 0.85  # of the motion, where its first way is looked at, and of that way what one shape tells
SHAPED = 0.05  # of the motion: what its shape may be off
ROUNDING = 1e-5  # of the largest motion: exact data are taken to have so much noise
RATES = np.geomspace(0.1, 5.0, 24)  # w, in radians a rise


@dataclasses.dataclass(frozen=True)
class Release:
    """The last still `row`, and the interval `low` to `high` of rows that holds it with 95 %; `rise`: rows from there
    to the first peak, about; `noise`: standard deviation of the rows along the motion, as a share of its size."""

    row: int
    low: int
    high: int
    rise: float
    noise: float

    @property
    def vague(self) -> bool:
        """Whether the interval is too wide to go on from: more than four rows and a third of the rise."""
        return self.high - self.low > max(4.0, self.rise / 3)


def found_release(recording: Recording) -> Release:
    """The release; row 0 where the recording begins with the motion. FitError where it cannot be told."""
    found = find_release(recording)
    if found.vague:
        low, high = recording.times[found.low], recording.times[found.high]
        raise FitError(
            f"the release cannot be told from the recording: it lies somewhere between {low:g} s and {high:g} s, with "
            f"noise of {100 * found.noise:.2g} % of the motion. Look at the recording and give release = TIME in s"
        )
    return found


def find_release(recording: Recording) -> Release:
    """The release with its interval. FitError where the markers do not move, or no more than their noise."""
    score = _along_early(recording)
    rows = np.flatnonzero(np.isfinite(score))
    s, times = score[rows], recording.times[rows] / recording.spacing
    s = s - np.median(s[:FEW])
    s = s * np.sign(s[np.argmax(np.abs(_median3(s)))])
    smooth = _median3(s)
    largest = float(smooth.max())
    half = int(np.argmax(smooth >= 0.5 * largest))
    before = np.flatnonzero(smooth[: half + 1] < 0.15 * largest)
    top = half + int(np.argmax(smooth[half:] >= 0.85 * largest))
    rise = max(1, top - (before[-1] if before.size else 0))
    start, end = max(0, half - max(BEFORE, 8 * rise)), min(len(s), top + 2)
    window, when = s[start:end], times[start:end]
    candidates = np.arange(rows[start], rows[half] + 1)  # rows in which nothing was seen too
    weight = _weights(s, smooth, largest)[start:end]
    ssr = _unexplained(window, weight, when, recording.times[candidates] / recording.spacing, rise)
    floor = len(window) * 1e-3 + np.finfo(float).tiny  # rounding, of exact data
    log = -0.5 * len(window) * np.log(ssr + floor)
    level = float(weight @ window / weight.sum())
    alone = -0.5 * len(window) * np.log(float(weight @ (window - level) ** 2) + floor)
    if len(window) < 4 or log.max() - alone < EVIDENCE:
        raise FitError(
            "no release is to be seen: the markers move no more than they scatter from row to row. Give "
            "release = TIME in s, or leave out what does not move"
        )
    likely = np.exp(log - log.max()).sum(axis=1)
    share = np.cumsum(likely) / likely.sum()
    tail = 0.5 * (1 - COVERED)
    low, high = int(np.searchsorted(share, tail)), int(np.searchsorted(share, 1 - tail))
    best = int(np.argmax(likely))
    noise = float(np.sqrt(ssr.min() / max(len(window) - 4, 1)) * weight.max() ** -0.5 / largest)
    at = candidates[[best, min(low, best), max(high, best)]]
    # Rows around the best in which nothing was seen cannot be told apart from it.
    at[1] = min(at[1], rows[rows <= at[0]].max(initial=rows[0]))
    at[2] = max(at[2], rows[rows > at[0]].min(initial=rows[-1]) - 1)
    return Release(int(at[0]), int(at[1]), int(at[2]), float(rise), noise)


def _along_early(recording: Recording) -> np.ndarray:
    """Where the markers are along the way that they first go (T,) [m]: on an arc that is not the strongest shape, along
    which they may hardly have moved while they are well on their way."""
    score = motion_along_shape(recording)
    rows = np.flatnonzero(recording.seen.all(axis=1))
    if len(rows) < 2 * FEW:
        return score
    places = recording.positions[rows].reshape(len(rows), -1)
    moved = places - np.median(places[:FEW], axis=0)
    far = _median3(np.linalg.norm(moved, axis=1))
    noise = np.sqrt(places.shape[1]) * max(scatter(each) for each in places.T)
    first = int(np.argmax(far >= max(EARLY * far.max(), 8 * noise)))
    way = moved[first : first + FEW].mean(axis=0)
    way = way / max(float(np.linalg.norm(way)), np.finfo(float).tiny)
    s = score[rows] - np.median(score[rows][:FEW])
    if first == 0 or np.abs(s[first : first + FEW].mean()) > ALONG * float(far[first]):
        return score  # the strongest shape is the first one, too
    along = np.full(len(score), np.nan)
    along[rows] = moved @ way
    return along


def settled_row(recording: Recording) -> int:
    """The first row from which the markers stay within 5 % of the largest excursion, or their noise, of their last
    places."""
    score = motion_along_shape(recording)
    rows = np.flatnonzero(np.isfinite(score))
    smooth = _median3(score[rows])
    away = np.abs(smooth - np.median(smooth[-max(FEW, len(smooth) // 20) :]))
    noise = 3 * scatter(score[rows][-len(rows) // 2 :])
    far = np.flatnonzero(away > max(SETTLED * away.max(), min(noise, 0.5 * away.max())))
    return int(rows[min(far[-1] + 1, len(rows) - 1)]) if far.size else 0


def motion_along_shape(recording: Recording) -> np.ndarray:
    """Where the markers are along the strongest shape of their motion (T,) [m], NaN where none is seen.

    A marker that is missing is told by the others. FitError for a marker without a sample, or no motion at all.
    """
    seen = recording.seen
    if not seen.any(axis=0).all():
        name = recording.names[int(np.argmin(seen.any(axis=0)))]
        raise FitError(f'marker "{name}" has no sample at all: leave it out')
    places = recording.positions - np.nanmedian(recording.positions, axis=0)
    known = np.where(seen[..., None], places, 0.0).reshape(len(places), -1)
    _, sizes, shapes = np.linalg.svd(known, full_matrices=False)
    if sizes[0] <= 1e-12 * np.nanmax(np.abs(recording.positions)) * np.sqrt(known.size):
        raise FitError("the markers do not move at all: there is no release to be found")
    shape = shapes[0]
    weight = (np.repeat(seen, 3, axis=1) * shape**2).sum(axis=1)
    score = known @ shape / np.where(weight > 0.05, weight, 1.0)
    return np.asarray(np.where(weight > 0.05, score, np.nan))


def scatter(signal: np.ndarray) -> float:
    """Standard deviation of white noise on a smooth signal (T,), by its fourth differences; robust."""
    if len(signal) < 6:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(signal, 4))) / np.sqrt(70))


def _weights(s: np.ndarray, smooth: np.ndarray, largest: float) -> np.ndarray:
    """1 / variance (T,) of each row: of the noise, and of how much the motion's shape may be off, a share of it."""
    noise = max(scatter(s), ROUNDING * largest)
    return np.asarray(1 / (noise**2 + (SHAPED * np.maximum(np.abs(smooth) - 3 * noise, 0.0)) ** 2))


def _unexplained(s: np.ndarray, weight: np.ndarray, times: np.ndarray, starts: np.ndarray, rise: float) -> np.ndarray:
    """Weighted sums of squares (R, W) left by the best still level and motion, for each time of the last still row and
    w."""
    share, root = weight / weight.sum(), np.sqrt(weight)
    k = np.maximum(times - starts[:, None], 0.0)[:, None, :]  # (R, 1, n)
    w = (RATES / rise)[None, :, None]
    angle = np.minimum(w * k, np.pi)
    shapes = [np.sin(np.minimum(angle, 0.5 * np.pi)), 1 - np.cos(angle)]
    shapes = [root * (each - (each @ share)[..., None]) for each in shapes]  # the still level
    signal = root * (s - s @ share)
    p, q = shapes
    pp, qq, pq = ((a * b).sum(-1) for a, b in ((p, p), (q, q), (p, q)))
    ps, qs = (p * signal).sum(-1), (q * signal).sum(-1)
    determinant = np.maximum(pp * qq - pq**2, 1e-12 * pp * qq + 1e-300)
    a, b = (qq * ps - pq * qs) / determinant, (pp * qs - pq * ps) / determinant
    both = np.where((a >= 0) & (b >= 0), a * ps + b * qs, 0.0)
    alone = [np.where(x > 0, x, 0.0) ** 2 / np.maximum(xx, 1e-300) for x, xx in ((ps, pp), (qs, qq))]
    explained = np.maximum(both, np.maximum(alone[0], alone[1]))
    return np.asarray(np.maximum((signal**2).sum() - explained, 0.0))


def _median3(s: np.ndarray) -> np.ndarray:
    padded = np.concatenate([s[:1], s, s[-1:]])
    return np.asarray(np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0))
