"""Many starts beside the scene's own, followed together: whether another minimum is lower, and how many end in one.

Sorted by their losses the ends of all starts make a waterfall (Raue et al. 2013): a low step that many share is a
minimum to rely on.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence

import numpy as np

from jaxfem.fitting.climbing import all_together
from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.search import Search, averages, stiffness_range
from jaxfem.fitting.unknowns import Unknowns
from jaxfem.materials.constants import Constant

TENFOLD = float(np.log(10.0))
ALIKE = 3.841458820694124
"""-2 log likelihood ratio up to which samples do not tell two ends apart (chi^2, one degree of freedom, 95 %)."""
NOTHING = 1e-12
"""Loss below which ends are exact: a millionth of the motion, or of the noise."""


@dataclasses.dataclass(frozen=True)
class End:
    """Where a start led: its values at the `start` and at the end, the `loss` there, whether it was `drawn`, and
    whether samples tell it from the `best` of all."""

    start: dict[str, float]
    values: dict[str, float]
    loss: float
    drawn: bool
    best: bool = False


def drawn(unknown: Unknowns, first: np.ndarray, given: Collection[str], count: int, seed: int) -> list[np.ndarray]:
    """Points z (P,) of a Latin hypercube (McKay et al. 1979): within bounds that were `given`, else within a factor of
    ten of the `first`, of what may have either sign within its size, 1 at least."""
    random = np.random.default_rng(seed)
    spans = [
        _span(each, z, low, high, each.name in given)
        for each, z, low, high in zip(unknown.constants, first, *unknown.box, strict=True)
    ]
    low, high = np.array(spans).T
    rows = np.stack([random.permutation(count) for _ in spans], axis=1)
    shares = (rows + random.uniform(size=rows.shape)) / count
    return list(low + shares * (high - low))


def _span(constant: Constant, z: float, low: float, high: float, given: bool) -> tuple[float, float]:
    if given or constant.absolute:
        return low, high
    longest = constant.transform.longest
    reach = TENFOLD * longest if np.isfinite(longest) else max(abs(z), 1.0)
    return max(low, z - reach), min(high, z + reach)


def followed(
    evaluator: Evaluator,
    coarse: Evaluator,
    first: np.ndarray,
    given: Collection[str],
    count: int,
    seed: int,
    search: Search,
    finer: Callable[[np.ndarray], np.ndarray],
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """(start, end, loss) of each drawn start: averages over a long time, a shorter one, then residuals as they are.

    A body's stiffness is drawn where it moves about as far as measured, as the usual search scans it. `coarse` takes
    fewer steps; `finer` takes a point from there to `evaluator`.
    """
    starts = drawn(evaluator.unknowns, first, given, count, seed)
    coarse.stage = evaluator.stage = "starts"
    axis, points = evaluator.unknowns.scanned, [each.copy() for each in starts]
    if axis is not None:
        low, high = stiffness_range(coarse, first, axis)
        shares = np.random.default_rng((seed, 1)).permutation(count)
        for each, share in zip(points, shares, strict=True):
            each[axis] = low + (share + 0.5) / count * (high - low)
        starts = [each.copy() for each in points]
        chosen = np.arange(first.size) == axis
        points = [z for z, _ in all_together(coarse, points, 4, averages(coarse, 4), chosen=chosen, tol=1e-2)]
    points = [z for z, _ in all_together(coarse, points, 8, averages(coarse, 20), tol=1e-3)]
    ends = all_together(evaluator, [finer(z) for z in points], search.polish, tol=search.tol)
    return [(start, *end) for start, end in zip(starts, ends, strict=True)]


def waterfall(
    unknown: Unknowns, ends: Sequence[tuple[np.ndarray, np.ndarray, float]], samples: int, inflation: float
) -> tuple[End, ...]:
    """The ends by their losses, lowest first; `ends`: the usual search's, then those of drawn starts. `samples` tell as
    much as samples / `inflation` independent ones."""
    losses = np.array([loss for *_, loss in ends])
    drop = samples / max(inflation, 1.0) * np.log((losses + NOTHING) / (losses.min() + NOTHING))
    found = [
        End(unknown.values(start), unknown.values(z), float(loss), number > 0, bool(drop[number] <= ALIKE))
        for number, (start, z, loss) in enumerate(ends)
    ]
    return tuple(sorted(found, key=lambda end: end.loss))


def in_words(ends: Sequence[End]) -> str:
    """One line: how many starts found the best."""
    same = sum(end.best for end in ends)
    others = [end.loss for end in ends if not end.best and np.isfinite(end.loss)]
    tail = f"; the next ended at {min(others) / max(ends[0].loss, 1e-300):.3g} times its loss" if others else ""
    return f"{same} of {len(ends)} starts led to the best{tail}"


def doubts(ends: Sequence[End]) -> list[str]:
    """Warnings where few starts found the best, or only drawn ones."""
    if not ends:
        return []
    texts, same = [], [end for end in ends if end.best]
    if len(same) <= max(1, len(ends) // 10):
        texts.append(
            f"only {in_words(ends)}: a better one may have been missed. Draw more starts (multi_start), give narrower "
            "bounds or priors, or hold what the samples tell least of"
        )
    if all(end.drawn for end in same):
        texts.append(
            "the search from the scene's own values ended in a worse minimum than drawn starts did: the values are "
            "those of the best drawn one"
        )
    return texts
