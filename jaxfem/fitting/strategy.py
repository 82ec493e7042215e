"""How a fit is searched for: with few steps a sample first, window by window where asked, from more starts where asked.

A long recording with contacts has a minimum for each order in which bodies may touch. Fitted from its beginning on, in
windows that grow, each starts from what the shorter one told, where the simulation still follows the recording.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.climbing import Goal, levenberg_marquardt
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.multistart import followed
from jaxfem.fitting.search import Search, find
from jaxfem.fitting.sharing import Shared
from jaxfem.fitting.weighting import Plain

MANY_SUBSTEPS = 3  # from here on, the search takes one step a sample and only the polish all of them
FEWEST_ROWS = 4  # of a window
Ends = list[tuple[np.ndarray, np.ndarray, float]]


@dataclasses.dataclass(frozen=True)
class Strategy:
    """`search`: how long; `windows` in which each take is fitted, from its beginning on; `multi_start` starts drawn
    with `seed` beside those given."""

    search: Search
    windows: int = 1
    multi_start: int = 0
    seed: int = 0


def checked_strategy(strategy: Strategy, rows: Sequence[int]) -> Strategy:
    """The strategy; FitError for counts that cannot be. `rows` of samples in each take."""
    for name, count, least in (("windows", strategy.windows, 1), ("multi_start", strategy.multi_start, 0)):
        if isinstance(count, bool) or not isinstance(count, int) or count < least:
            raise FitError(f"{name} is {count!r}: give a whole number from {least} up")
    if strategy.windows > 1 and min(rows) < FEWEST_ROWS * strategy.windows:
        raise FitError(
            f"windows is {strategy.windows}, but a take has {min(rows)} samples: give at most "
            f"{max(1, min(rows) // FEWEST_ROWS)}"
        )
    return strategy


def searching(evaluator: Evaluator) -> Evaluator:
    """Takes one step a sample where many are asked for."""
    most = max(piece.plan.every for piece in evaluator.pieces)
    return evaluator.with_steps(1) if most >= MANY_SUBSTEPS else evaluator


def searched(
    evaluator: Evaluator, coarse: Evaluator, shared: Shared, strategy: Strategy
) -> tuple[np.ndarray, str, Ends]:
    """(z, status, ends of all starts): the best point found; `coarse`: the same fit with fewer steps. The first of the
    ends is the usual search's; there are none where no starts were drawn."""
    search, z, ends = strategy.search, None, Ends()
    try:
        z = _found(evaluator, coarse, shared.starts, strategy)
        polished = sum(visit.stage == "polish" for visit in evaluator.history)
        status = "converged" if polished < 2 * search.polish else "iteration limit"
        if strategy.multi_start:
            first, count, seed = shared.starts[0], strategy.multi_start, strategy.seed
            more = followed(
                evaluator,
                coarse,
                first,
                shared.bounded,
                count,
                seed,
                search,
                lambda end: _finer(evaluator, coarse, end),
            )
            loss = Goal(evaluator, Plain()).value(z, evaluator.residual(z)[0])
            ends = [(first, z, loss), *more]
            z = min(ends, key=lambda end: end[2])[1]
    except KeyboardInterrupt:
        best = evaluator.best if evaluator.best is not None else coarse.best
        known = [np.asarray(each) for each in (z, best) if each is not None]
        if not known:
            raise
        if len(known) > 1:  # drawn starts may have found a better one
            goal = Goal(evaluator, Plain())
            known.sort(key=lambda each: goal.value(each, evaluator.residual(each)[0]))
        return known[0], "interrupted", Ends()
    if not np.isfinite(evaluator.best_loss):
        raise FitError(
            "no trial gave a finite motion: check that the scene itself runs, take a smaller dt, or narrow the bounds"
        )
    return z, status, ends


def _found(evaluator: Evaluator, coarse: Evaluator, starts: list[np.ndarray], strategy: Strategy) -> np.ndarray:
    """The usual search."""
    search, short = strategy.search, dataclasses.replace(strategy.search, polish=6, tol=1e-2)
    if coarse is evaluator and strategy.windows == 1:
        return find(evaluator, starts, search)
    z = find(coarse.until(1 / strategy.windows) if strategy.windows > 1 else coarse, starts, short)
    coarse.best = z if coarse.best is None else coarse.best  # what an interruption finds
    for number in range(2, strategy.windows + 1):
        longer = coarse.until(number / strategy.windows) if number < strategy.windows else coarse
        longer.stage = "windows"
        z, _ = levenberg_marquardt(longer, z, short.polish, tol=short.tol)
    evaluator.stage = "polish"
    return levenberg_marquardt(evaluator, _finer(evaluator, coarse, z), search.polish, tol=search.tol)[0]


def _finer(evaluator: Evaluator, coarse: Evaluator, z: np.ndarray) -> np.ndarray:
    """What larger backward Euler steps damped, handed to the material: a mode loses omega (beta + dt) / 2 in all."""
    unknown, piece = evaluator.unknowns, evaluator.pieces[0]
    if coarse is evaluator or piece.problem.model.scheme.order > 1:
        return z
    values = unknown.values(z)
    for each in unknown.constants:
        if each.viscous:
            values[each.name] += float(piece.problem.dt) * (piece.plan.every - 1)
    return unknown.unknown(values)
