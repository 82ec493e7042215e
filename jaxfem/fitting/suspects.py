"""What residuals that are left look like: errors of a recording leave columns of their own, which cost no simulation.

Residuals that are smooth in time say that something is missing, in the model or in the recording. With the simulated
places s and their velocity v a recording that is otherwise right leaves of s less what was measured
    c t v             where its times are too long by the share c,
    tau v             at a marker that is behind the others by tau,
    -tau v            behind rows that were lost, worth tau,
    s - G s           where it was smoothed by a filter G,
    -k (s - s_0)      where motion is too large by the share k,
    -k mean(s - s_0)  where it began from elsewhere than markers stood before,
    -omega x (s - s_0)  where its axes are turned by the small angle omega.
What counts is how much of the residuals such a column tells that no change of the fitted values would: the statistic of
a Lagrange multiplier test (Rao 1948; Silvey 1959), as a share of all that is left. It is a suspicion: the same may be
told by what a body does and its model does not.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from jaxfem.fitting.advice import smooth
from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.result import TakeFit
from jaxfem.fitting.statistics import Uncertainty

TOLD = 0.6
"""Share of what is left that is to be told for causes to be named."""
EACH = 0.2
"""Share that each of them is to tell."""
AT_ONCE = 2
AS_GOOD = 0.03
"""Of that share: what tells as much is named beside."""
LEAST = 0.1
"""Share of what is left that is taken to be more than noise at least."""
SEEN = 0.05
"""Share of a column that is to be left beside those of the fitted values: of less, next to nothing is known."""
SHARE, ANGLE, FILTER, ROWS = (-0.3, 0.3), (0.0, float(np.radians(30.0))), (0.5, 2.0), 10.0
"""Between which amounts are believed: columns are those of small ones. A filter's is 1, of one near it not quite."""
ABOVE = 3.0
"""Times the scatter of markers from one sample to the next: residuals are more than noise."""
FEWEST = 8
"""Rows of a recording that tell a shape in time."""
PLACES = 200  # at which lost rows are looked for


WIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Standard deviations of filters, rows."""


class Cause(NamedTuple):
    """`kind`: the best of each counts; `columns` (k, T, M, 3) of the residuals, in their unit; `words`: the cause with
    the amounts (k,) found in words; `believed`: between which it is, or the size of several."""

    kind: str
    columns: np.ndarray
    words: Callable[[np.ndarray], str]
    believed: tuple[float, float]


def suspects(take: TakeFit, weights: np.ndarray, jacobian: np.ndarray, turn: float = np.inf) -> list[str]:
    """Causes in words, one or two of which tell most of the residuals; none where these do not.

    `weights` (T, M, 3) of the samples, `jacobian` (P, T, M, 3) of the weighted residuals; `turn`: the largest angle
    [rad] by which axes may be turned.
    """
    there = (weights > 0) & np.isfinite(take.residuals)
    if len(take.times) < FEWEST or not np.isfinite(jacobian[:, there]).all():  # the latter: of steps that failed
        return []
    left = (weights * np.nan_to_num(take.residuals))[there]
    known = np.linalg.qr(jacobian[:, there].T)[0]
    left = left - known @ (known.T @ left)
    whole = max(float(left @ left) - _noise(weights * take.residuals), LEAST * float(left @ left))
    found, told = list[str](), 0.0
    while whole > 0 and len(found) < AT_ONCE and told < TOLD:
        best_of: dict[str, _Part] = {}
        for cause in _causes(take, turn):  # made anew: those of a long recording are large together
            part = _part(cause, (weights * cause.columns)[:, there].T, known, left)
            best_of[cause.kind] = max(best_of.get(cause.kind, part), part, key=lambda each: each.told)
        parts = sorted(best_of.values(), key=lambda each: -each.told)
        if parts[0].told < EACH * whole:
            return []
        best = parts[0]
        found.append(", or ".join(each.words for each in parts if each.told > best.told - AS_GOOD * whole))
        told += best.told / whole
        known, left = np.concatenate([known, best.basis], axis=1), left - best.basis @ (best.basis.T @ left)
    return found if told >= TOLD else []


def _noise(residuals: np.ndarray) -> float:
    """Sum of squares of what is not alike from one row to the next (von Neumann 1941)."""
    steps = np.diff(residuals, axis=0)
    count = np.isfinite(residuals).sum() / max(np.isfinite(steps).sum(), 1)
    return 0.5 * float(np.nansum(steps**2) * count)


class _Part(NamedTuple):
    told: float
    words: str
    basis: np.ndarray


def _part(cause: Cause, own: np.ndarray, known: np.ndarray, left: np.ndarray) -> _Part:
    """What its weighted columns (N, k) tell of what is `left` (N,) beside those `known` (N, p), orthonormal."""
    beside = own - known @ (known.T @ own)
    if np.linalg.norm(beside) < SEEN * np.linalg.norm(own):
        return _Part(0.0, "", beside[:, :0])
    basis, triangle = np.linalg.qr(beside)
    along = basis.T @ left
    amounts = np.linalg.lstsq(triangle, along, rcond=1e-9)[0]
    low, high = cause.believed
    size = amounts[0] if len(amounts) == 1 else np.linalg.norm(amounts)
    return _Part(float(along @ along) if low <= size <= high else 0.0, cause.words(amounts), basis)


def unfollowed(uncertainty: Uncertainty, takes: Sequence[TakeFit]) -> list[str]:
    """A warning of each take whose residuals are far above what its markers scatter by from one sample to the next.

    Residuals that ring need not be alike from sample to sample on the whole: their correlations cancel.
    """
    return [
        f"{each.name}: residuals are {each.noise / each.scatter:.2g} times what its markers scatter by from one sample "
        "to the next: the model leaves out something that the body does, or the recording is not what it is taken for "
        "(its release, its times, a marker behind the others). Error bars know nothing of that bias"
        for each in takes
        if not smooth(uncertainty) and uncertainty.noise > 1e-6 and each.noise > ABOVE * each.scatter > 0
    ]


def told_suspects(
    takes: Sequence[TakeFit], evaluator: Evaluator, jacobian: Sequence[np.ndarray], turns: Sequence[float]
) -> list[str]:
    """A warning for each take whose residuals look like an error of its recording; `turns` [rad] that axes may have."""
    texts = []
    for take, piece, columns, turn in zip(takes, evaluator.pieces, jacobian, turns, strict=True):
        if found := suspects(take, np.asarray(piece.problem.weights, np.float64), columns, turn):
            where = f"{take.name}: " if len(takes) > 1 else ""
            texts.append(
                f"{where}what is left looks as if {' and '.join(found)}. If the recording is so, mend it and fit "
                "again: values are off by what that does to them"
            )
    return texts


def _causes(take: TakeFit, turn: float) -> Iterator[Cause]:
    """All that are looked for. Velocities are the mean of those simulated and measured: lags may then be long."""
    from scipy.ndimage import gaussian_filter1d

    times, places = take.times, take.simulated
    interval = float(np.median(np.diff(times)))
    lags = -ROWS * interval, ROWS * interval
    velocity, measured = (np.gradient(each, times, axis=0) for each in (places, take.measured))
    velocity = np.where(np.isfinite(measured), 0.5 * (velocity + measured), velocity)
    moved = np.where(np.isfinite(take.measured), take.measured, places) - places[0]
    yield Cause("clock", ((times - times[0])[:, None, None] * velocity)[None], _clock, SHARE)
    for rows in WIDTHS:
        smoothed = gaussian_filter1d(places, rows, axis=0, mode="nearest", truncate=3.0)  # still before
        yield Cause("filter", (places - smoothed)[None], partial(_smoothed, rows * interval), FILTER)
    yield Cause("release", velocity[None], partial(_late, "all motion", "where the release was found", interval), lags)
    yield Cause("origin", -np.broadcast_to(moved.mean(axis=0), moved.shape)[None], _aside, SHARE)
    yield Cause("scale", -moved[None], partial(_scaled, "all markers move"), SHARE)
    if take.unit == "m":
        believed = ANGLE[0], min(ANGLE[1], turn)
        yield Cause("axes", np.stack([-np.cross(axis, moved) for axis in np.eye(3)]), _turned, believed)
    for number, name in enumerate(take.markers):
        of = (np.arange(len(take.markers)) == number).astype(float)[:, None]
        yield Cause("marker", (of * velocity)[None], partial(_late, name, "the others", interval), lags)
        yield Cause("marker", -(of * moved)[None], partial(_scaled, f"{name} moves"), SHARE)
    begin = max(2, len(times) // 10)  # before, lost rows are a release that was found late
    for row in range(begin, len(times) - 2, max(1, len(times) // PLACES)):
        after = (times >= times[row]).astype(float)[:, None, None]
        yield Cause("rows", -(after * velocity)[None], partial(_lost, times[row], interval), lags)


def _way(amount: float, more: str, less: str) -> str:
    return more if amount > 0 else less


def _clock(share: np.ndarray) -> str:
    return (
        f"times are {100 * abs(share[0]):.2g} % too {_way(share[0], 'long', 'short')} (the rate of the frames), or the "
        f"material is {_way(share[0], 'softer', 'stiffer')} when it rings than when it hangs"
    )


def _smoothed(width: float, _: np.ndarray) -> str:
    """A filter of this standard deviation; of another one near where the amount is not 1."""
    return f"places were smoothed over some {2 * width:.2g} s (a filter at about {0.1325 / width:.2g} Hz)"


def _scaled(what: str, share: np.ndarray) -> str:
    return f"{what} {100 * abs(share[0]):.2g} % too {_way(share[0], 'much', 'little')}"


def _aside(share: np.ndarray) -> str:
    return (
        f"markers stood {100 * abs(share[0]):.2g} % of the motion aside of where they were let go (a hand that moved "
        "before the release: fewer still rows, or compare places)"
    )


def _turned(angles: np.ndarray) -> str:
    size = float(np.linalg.norm(angles))
    axis = ", ".join(f"{each:.2g}" for each in angles / max(size, 1e-300))
    return f"the recording's axes are turned by {np.degrees(size):.2g} degrees about ({axis})"


def _late(what: str, than: str, interval: float, lag: np.ndarray) -> str:
    rows = abs(lag[0]) / interval
    return f"{what} is {abs(lag[0]):.2g} s ({rows:.2g} rows) {_way(lag[0], 'behind', 'ahead of')} {than}"


def _lost(time: float, interval: float, lag: np.ndarray) -> str:
    rows, what = abs(lag[0]) / interval, _way(lag[0], "lost", "doubled")
    return f"{rows:.2g} rows were {what} at {time:.3g} s after the release, with no gap in the times"
