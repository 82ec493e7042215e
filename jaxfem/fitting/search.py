"""Global and local search for a few unknowns of a ringing body: scan, smooth, descend, polish.

The loss of ringing data has a local minimum in the stiffness for each cycle by which the simulation may be off.
Averaged over time the ringing goes and what stays, how far the body sinks, depends on the stiffness monotonically: so
residuals are first smoothed over a long time, then over a shorter one, then taken as they are.
"""

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxfem.fitting.climbing import levenberg_marquardt
from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.weighting import Plain, Smoothed, Weighting, smoother

if TYPE_CHECKING:  # slow to import: only where its steps are asked for
    import optax

SCAN_RATIO = 2.0
JUMPS = 6
SAME = 0.02
"""Of z: starts of a descent that are nearer to each other lead to one place."""
IN_STEP = (2 * np.sin(np.pi / 12)) ** 2
"""Square of what a lag of a twelfth of a cycle leaves of an oscillation."""
TOO_FAR = 3.0  # times the measured excursion: softer values need not be tried


@dataclasses.dataclass(frozen=True)
class Search:
    """How long to search.

    `candidates` kept after the scan; `descent` steps on each of an optax `optimizer` (Adam when None); `polish`
    Levenberg-Marquardt steps, until one gains less than `tol` of the loss. Each stage stops early when it gains no
    more. With few unknowns Levenberg-Marquardt found, from the scan, the same minimum in all trials and in half the
    evaluations, so `descent` is 0 unless asked for.
    """

    candidates: int = 2
    descent: int = 0
    polish: int = 40
    tol: float = 1e-6
    optimizer: "optax.GradientTransformation | None" = None


def find(evaluator: Evaluator, starts: list[np.ndarray], search: Search) -> np.ndarray:
    """The best z (P,) found from the starting points; KeyboardInterrupt is left to the caller."""
    long, short = (averages(evaluator, share) for share in (4, 20))
    found = [point for start in starts for point in _scan(evaluator, start, long)]
    picked = sorted(found, key=lambda each: each[0])[: search.candidates]
    ends, begun = [], list[np.ndarray]()
    for _, z in picked:
        evaluator.stage = "coarse"
        z = _coarse(evaluator, z, long)
        if any(np.abs(z - other).max() < SAME for other in begun):
            continue  # two candidates of one minimum
        begun.append(z)
        evaluator.stage = "descent"
        if search.descent or not _in_step(evaluator, z, short):
            z = _descend(evaluator, z, short, search)
            z, _ = levenberg_marquardt(evaluator, z, 8, short, tol=1e-3, sure=False)
        ends.append((evaluator.loss(short.residual(evaluator.residual(z)[0])), tuple(z)))
    evaluator.stage = "polish"
    best, lowest = np.array(picked[0][1]), np.inf
    for k, (_, end) in enumerate(sorted(ends)):
        if any(np.abs(np.array(end) - other).max() < 1e-3 * SAME for _, other in sorted(ends)[:k]):
            continue
        if np.isfinite(lowest) and evaluator.loss(evaluator.residual(np.array(end))[0]) > 30 * lowest:
            continue
        z, loss = levenberg_marquardt(evaluator, np.array(end), search.polish, tol=search.tol)
        if loss < lowest:
            best, lowest = z, loss
    return best


def averages(evaluator: Evaluator, share: float) -> Smoothed:
    """Averages over a share of each take."""
    smoothers = []
    for piece in evaluator.pieces:
        times = np.asarray(piece.problem.times, np.float64)
        seen = np.asarray(piece.problem.weights, np.float64)[..., 0] > 0
        there = times[seen.any(axis=1)]
        smoothers.append(smoother(times, seen, float(np.ptp(there)) / share))
    return Smoothed(smoothers)


def _scan(evaluator: Evaluator, start: np.ndarray, smooth: Weighting) -> list[tuple[float, np.ndarray]]:
    """Minima of the smoothed and of the full loss over the stiffness, from stiff to soft, where the motion is of the
    right size.

    Soft bodies fold up, and are slow to simulate: the scan ends once the body moves much farther than measured.
    """
    evaluator.stage = "scan"
    axis = evaluator.unknowns.scanned
    if axis is None:
        return [(evaluator.loss(evaluator.residual(start)[0]), start)]
    low, high = stiffness_range(evaluator, start, axis)
    count = max(3, int(np.ceil((high - low) / np.log(SCAN_RATIO))) + 1)
    points, losses, beyond = [], [], 0
    for value in np.linspace(high, low, count):
        z = _changed(start, axis, value)
        r, outcomes = evaluator.residual(z)
        points.append(z)
        losses.append((evaluator.loss(smooth.residual(r)), evaluator.loss(r)))
        ratio = _excursion_ratio(evaluator, outcomes)
        beyond = beyond + 1 if ratio > TOO_FAR else 0
        if beyond == 2 or ratio > 2 * TOO_FAR:
            break
    table = np.array(losses)
    smoothed = _minima(table[:, 0])
    others = [i for i in _minima(table[:, 1]) if min(abs(i - each) for each in smoothed) > 1]  # neighbours: one minimum
    return [(table[i, 0], points[i]) for i in sorted({*smoothed, *others})]


def stiffness_range(evaluator: Evaluator, start: np.ndarray, axis: int) -> tuple[float, float]:
    """Where to scan log E: a factor of six about a value at which the body moves about as far as measured, found by E
    <- E times the ratio of both; all of the bounds where that leads nowhere, as under a prescribed motion."""
    low, high = (float(bound[axis]) for bound in evaluator.unknowns.box)
    z = as_far(evaluator, start, axis)
    return (low, high) if z is None else (max(low, z[axis] - np.log(6.0)), min(high, z[axis] + np.log(6.0)))


def as_far(evaluator: Evaluator, start: np.ndarray, axis: int) -> np.ndarray | None:
    """The start (P,) with the stiffness at which the body moves about as far as measured; None where none is found."""
    low, high = (float(bound[axis]) for bound in evaluator.unknowns.box)
    value = float(start[axis])
    for _ in range(JUMPS):
        z = _changed(start, axis, value)
        ratio = _excursion_ratio(evaluator, evaluator.residual(z)[1])
        if 0.5 < ratio < 2.0:
            return z
        value = float(np.clip(value + np.clip(np.log(ratio), -8.0, 3.0), low, high)) if ratio > 0 else low
    return None


def _changed(z: np.ndarray, axis: int, value: float) -> np.ndarray:
    changed = z.copy()
    changed[axis] = value
    return changed


def _minima(values: np.ndarray) -> list[int]:
    padded = np.concatenate([[np.inf], np.where(np.isfinite(values), values, np.inf), [np.inf]])
    lowest = [i for i in range(len(values)) if padded[i + 1] <= min(padded[i], padded[i + 2])]
    return [i for i in lowest if np.isfinite(values[i])] or [0]


def _excursion_ratio(evaluator: Evaluator, outcomes: Any) -> float:
    """How far the simulated markers swing about their mean places, as a multiple of what the measured ones do; the
    middle one of several takes."""
    ratios = []
    for piece, outcome in zip(evaluator.pieces, outcomes, strict=True):
        seen = np.asarray(piece.problem.weights) > 0
        places = (outcome.simulated, piece.problem.measured)
        far, real = (_swing(np.asarray(a, np.float64), seen) for a in places)
        ratios.append(far / real if np.isfinite(far) and real > 0 else np.inf)
    return float(np.median(ratios))


def _swing(positions: np.ndarray, seen: np.ndarray) -> float:
    positions = np.where(seen, positions, 0.0)
    mean = positions.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    return float(np.linalg.norm(np.where(seen, positions - mean, 0.0), axis=-1).max())


def _coarse(evaluator: Evaluator, z: np.ndarray, smooth: Weighting) -> np.ndarray:
    """Only the stiffness, on strongly smoothed residuals: what they say of the rest is little."""
    chosen = np.arange(z.size) == evaluator.unknowns.scanned
    return levenberg_marquardt(evaluator, z, 4, smooth, chosen=chosen, tol=1e-2, sure=False)[0] if chosen.any() else z


def _in_step(evaluator: Evaluator, z: np.ndarray, short: Smoothed) -> bool:
    """Whether the simulation at z rings with the recording all along.

    Of what averages over a short time leave out, less is off than a lag of a twelfth of a cycle makes. Averages then
    have no other minimum to lead to, and tell damping and delay worse than the ringing does.
    """
    r, outcomes = evaluator.residual(z)
    if evaluator.unknowns.scanned is None or not all(np.isfinite(each).all() for each in r):
        return False
    motions = []
    for piece, outcome in zip(evaluator.pieces, outcomes, strict=True):
        weights = np.asarray(piece.problem.weights, np.float64)
        places, seen = np.asarray(outcome.measured, np.float64), weights > 0
        mean = np.where(seen, places, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        motions.append(np.where(seen, weights * (places - mean), 0.0))
    off, there = (np.sum((Plain().residual(each) - short.residual(each)) ** 2) for each in (r, motions))
    return bool(off < IN_STEP * there)


def _descend(evaluator: Evaluator, z: np.ndarray, smooth: Weighting, search: Search) -> np.ndarray:
    """An optax optimiser on the logarithm of the smoothed loss: steps of a set size, blind to bad scaling."""
    if search.descent == 0:
        return z
    import optax

    optimizer = search.optimizer or optax.adam(0.15, b1=0.7, b2=0.9)
    low, high = evaluator.unknowns.box
    state, best, lowest, idle = optimizer.init(z), z, np.inf, 0
    for _ in range(search.descent):
        r, jacobian, _ = evaluator.linear(z)
        smoothed = smooth.residual(r)
        loss = evaluator.loss(smoothed)
        idle = 0 if loss < 0.95 * lowest else idle + 1
        if loss < lowest:
            best, lowest = z, loss
        if idle == 3 or not np.isfinite(loss) or loss == 0:
            break
        gradient = 2 * smooth.columns(jacobian) @ smoothed / evaluator.samples / loss
        updates, state = optimizer.update(gradient, state, z)
        z = np.clip(np.asarray(optax.apply_updates(z, updates), np.float64), low, high)
    return best
