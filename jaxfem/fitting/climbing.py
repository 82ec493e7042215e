"""Levenberg-Marquardt: least squares from one point, or from many whose simulations run side by side.

A climb is written once, as a generator: it asks for the residuals of a point, with or without derivatives, and goes on
with them. Whoever drives it decides how they are made. Derivatives cost several simulations: a step that went about
where they said corrects them by what was found there (Broyden 1965), and new ones are made where one did not, and to
tell the end.
"""

import dataclasses
from collections.abc import Generator, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxfem.fitting.evaluation import Evaluator, Near
from jaxfem.fitting.weighting import Plain, Weighting

Ended = tuple[np.ndarray, float]
TRIES = 8
FINER = 0.01
"""Share of the gain to stop at, where derivatives were only corrected: what they promise is less sure, and cheap."""
FORETOLD = 0.3
"""Share of a step's change that may be other than foretold, for the derivatives to serve another step."""
SPENT = 0.01
"""Share of what derivatives promised where they were made, below which corrected ones know no more: a correction tells
how residuals change along the steps alone, and where the model leaves something out the last of the way is another."""
NEARLY = 1e-3
"""Share of the loss that made derivatives promise, below which a step is as good as taken: its end is asked for with
derivatives at once."""
SHORTER = 0.5
"""Length of the next step that is tried, at most, as a share of one that led up."""


class Ask(NamedTuple):
    """The residuals of all takes at `z` (P,), with `derivatives` or without."""

    z: np.ndarray
    derivatives: bool


@dataclasses.dataclass(frozen=True)
class Goal:
    """What is minimised: the mean square of weighted residuals, and of what is known of the unknowns before."""

    evaluator: Evaluator
    weighting: Weighting

    def value(self, z: np.ndarray, r: Any) -> float:
        """The loss at z, where the residuals are r."""
        return self.evaluator.loss(self.weighting.residual(r)) + self._before(z)[0]

    def linear(self, z: np.ndarray, r: Any, jacobian: Any) -> tuple[float, np.ndarray, np.ndarray]:
        """Loss, J'J (P, P) and J'r (P,) at z."""
        flat, columns = self.weighting.residual(r), self.weighting.columns(jacobian)
        loss, normal, gradient = self._before(z)
        return loss + self.evaluator.loss(flat), normal + columns @ columns.T, gradient + columns @ flat

    def gain(self, loss: float, normal: np.ndarray, gradient: np.ndarray, free: np.ndarray) -> float:
        """The share of the loss that a full Gauss-Newton step of the `free` unknowns promises."""
        step = _damped_step(normal[np.ix_(free, free)], gradient[free], 1e-12)
        return float(-gradient[free] @ step) / max(self.evaluator.samples, 1) / loss

    def misses(self, step: np.ndarray, r: Any, jacobian: Any, new: Any) -> float:
        """By how much the residuals `new` behind a step are off what was foretold, as a share of their change."""
        before, after = self.weighting.residual(r), self.weighting.residual(new)
        change = after - before
        off = change - step @ self.weighting.columns(jacobian)
        return float(np.linalg.norm(off) / max(np.linalg.norm(change), np.finfo(float).tiny))

    def _before(self, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        if self.evaluator.priors is None:
            return 0.0, np.zeros((z.size, z.size)), np.zeros(z.size)
        rows, jacobian = self.evaluator.priors.rows(z)
        variance = self.evaluator.variance
        return (
            variance * float(rows @ rows) / max(self.evaluator.samples, 1),
            variance * jacobian.T @ jacobian,
            variance * jacobian.T @ rows,
        )


def levenberg_marquardt(
    evaluator: Evaluator,
    z: np.ndarray,
    iterations: int,
    weighting: Weighting | None = None,
    *,
    chosen: np.ndarray | None = None,
    tol: float = 1e-9,
    sure: bool = True,
) -> Ended:
    """Least squares from z inside the box: (z, loss). Stops when a step gains less than `tol` of the loss.

    Levenberg 1944, Marquardt 1963, with steps of at most a factor e and unknowns held at bounds they push against. No
    step is tried where even the undamped one promises less: its Jacobian then serves whoever goes on from z.
    `chosen` (P,): those that are searched, all of them when None; `sure`: that the end is one is told by derivatives
    made there.
    """
    climb = _climb(Goal(evaluator, weighting or Plain()), z, iterations, chosen, tol, sure)
    try:
        ask = next(climb)
        while True:
            ask = climb.send(evaluator.linear(ask.z) if ask.derivatives else evaluator.residual(ask.z))
    except StopIteration as end:
        return end.value[0], end.value[1]


def all_together(
    evaluator: Evaluator,
    starts: Sequence[np.ndarray],
    iterations: int,
    weighting: Weighting | None = None,
    *,
    chosen: np.ndarray | None = None,
    tol: float = 1e-9,
) -> list[Ended]:
    """`levenberg_marquardt` from each of the starts; what they ask for at a time is simulated side by side."""
    goal = Goal(evaluator, weighting or Plain())
    climbs = [_climb(goal, z, iterations, chosen, tol, True) for z in starts]
    asked, ended = dict[int, Ask](), dict[int, Ended]()

    def go_on(number: int, told: Any) -> None:
        try:
            asked[number] = climbs[number].send(told)
        except StopIteration as end:
            ended[number] = end.value
            asked.pop(number, None)

    for number in range(len(climbs)):
        go_on(number, None)
    while asked:
        # Trials first: those that need several then catch up with the others before the next derivatives.
        derivatives = all(ask.derivatives for ask in asked.values())
        now = [number for number, ask in asked.items() if ask.derivatives == derivatives]
        found = evaluator.together([asked[number].z for number in now], derivatives)
        for number, told in zip(now, found, strict=True):
            go_on(number, told)
    return [ended[number] for number in range(len(climbs))]


def _climb(
    goal: Goal, z: np.ndarray, iterations: int, chosen: np.ndarray | None, tol: float, sure: bool
) -> Generator[Ask, Any, Ended]:
    """The steps, as what they ask for: (z, loss) at the end."""
    chosen = np.ones(z.size, bool) if chosen is None else chosen
    low, high = goal.evaluator.unknowns.box
    damping, promised, at, last = 1e-3, 0.0, goal.evaluator.near, goal.evaluator.last
    made_here = last is not None and np.array_equal(last[0], z)  # asked for again they cost nothing
    if at is None or made_here or not np.array_equal(at.z, z):
        at = yield from _made(z)
    for _ in range(iterations):
        loss, normal, gradient = goal.linear(at.z, at.r, at.jacobian)
        if not (np.isfinite(loss) and np.isfinite(normal).all()):
            return at.z, loss
        free = chosen & ~((at.z <= low) & (gradient > 0)) & ~((at.z >= high) & (gradient < 0))
        certain = at.made or not sure
        promise = goal.gain(loss, normal, gradient, free) if free.any() and loss >= 1e-24 else 0.0
        promised = promise if at.made else promised
        least = tol if certain else max(FINER * tol, SPENT * promised)
        if promise <= least:
            if certain:
                break
            at = yield from _made(at.z)
            continue
        ask = Ask(at.z, sure and at.made and promise < NEARLY)
        tries = TRIES if at.made else 1
        there, told, gain, damping = yield from _better(goal, ask, loss, normal, gradient, free, damping, tries)
        if there is None:
            if at.made:
                break
            at = yield from _made(at.z)
            continue
        step = there.z - at.z
        small = gain < least or np.abs(step).max() < 1e-8
        foretold = goal.misses(step, at.r, at.jacobian, told[0]) < FORETOLD
        serve = not goal.evaluator.whole and (foretold or (small and certain))  # those of the trial are there, else
        if there.derivatives:
            at = Near(there.z, told[0], told[1], True)
        else:
            at = at.stepped(there.z, told[0]) if serve else (yield from _made(there.z))
        if small and certain:
            break
    goal.evaluator.near = at
    return at.z, goal.value(at.z, at.r)


def _made(z: np.ndarray) -> Generator[Ask, Any, Near]:
    """Residuals and derivatives made at z."""
    r, jacobian, _ = yield Ask(z, True)
    return Near(z.copy(), r, jacobian, True)


def _better(
    goal: Goal,
    ask: Ask,
    loss: float,
    normal: np.ndarray,
    gradient: np.ndarray,
    free: np.ndarray,
    damping: float,
    tries: int,
) -> Generator[Ask, Any, tuple[Ask | None, Any, float, float]]:
    """A point with less loss than `ask.z`, None where none is found; what is told of it, share of the loss gained, next
    damping. Derivatives, where asked for, are made at the first that is tried."""
    z = ask.z
    low, high = goal.evaluator.unknowns.box
    longest = np.array([each.transform.longest for each in goal.evaluator.unknowns.constants])

    def step_of(damping: float) -> np.ndarray:
        step = np.zeros_like(z)
        step[free] = _damped_step(normal[np.ix_(free, free)], gradient[free], damping)
        shorter = min(1.0, 1 / max((np.abs(step) / longest).max(), 1e-300))  # all of it, to go where the model says
        bounded = np.clip(z + shorter * step, low, high)
        return np.asarray(bounded - z)

    step = step_of(damping)
    for _ in range(tries):
        ask = ask._replace(z=z + step)
        told = yield ask
        new = goal.value(ask.z, told[0])
        if new < loss:
            return ask, told, 1 - new / loss, max(damping / 10, 1e-12)
        if np.abs(step).max() < 1e-8:
            break
        ask, damping, tried = ask._replace(derivatives=False), 10 * damping, step
        while _length(step := step_of(damping), normal) > SHORTER * _length(tried, normal):
            damping *= 10
    return None, None, 0.0, damping


def _length(step: np.ndarray, normal: np.ndarray) -> float:
    """Of a step, unknowns measured by what they move."""
    return float(np.sqrt(np.sum(np.diag(normal) * step**2)))


def _damped_step(normal: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    diagonal = np.diag(normal)
    # An unknown that the data do not see yet must not run away: its diagonal entry is kept off zero.
    scale = np.maximum(diagonal, 1e-6 * diagonal.max() + np.finfo(float).tiny)
    return np.asarray(np.linalg.solve(normal + damping * np.diag(scale), -gradient))
