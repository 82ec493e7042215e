"""Levenberg-Marquardt: least squares from one point, or from many whose simulations run side by side.

A climb is written once, as a generator: it asks for the residuals of a point, with or without derivatives, and goes on
with them. Whoever drives it decides how they are made.
"""

import dataclasses
from collections.abc import Generator, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.weighting import Plain, Weighting

Ended = tuple[np.ndarray, float]


class Ask(NamedTuple):
    """The residuals of all takes at `z` (P,), with `derivatives` or without."""

    z: np.ndarray
    derivatives: bool


Climb = Generator[Ask, Any, Ended]


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
) -> Ended:
    """Least squares from z inside the box: (z, loss). Stops when a step gains less than `tol` of the loss.

    Levenberg 1944, Marquardt 1963, with steps of at most a factor e and unknowns held at bounds they push against. No
    step is tried where even the undamped one promises less: its Jacobian then serves whoever goes on from z.
    `chosen` (P,): those that are searched, all of them when None.
    """
    climb = _climb(Goal(evaluator, weighting or Plain()), z, iterations, chosen, tol)
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
    climbs = [_climb(goal, z, iterations, chosen, tol) for z in starts]
    asked = {number: next(climb) for number, climb in enumerate(climbs)}
    ended: dict[int, Ended] = {}
    while asked:
        # Trials first: those that need several then catch up with the others before the next derivatives.
        derivatives = all(ask.derivatives for ask in asked.values())
        now = [number for number, ask in asked.items() if ask.derivatives == derivatives]
        found = evaluator.together([asked[number].z for number in now], derivatives)
        for number, told in zip(now, found, strict=True):
            try:
                asked[number] = climbs[number].send(told)
            except StopIteration as end:
                ended[number] = end.value
                del asked[number]
    return [ended[number] for number in range(len(climbs))]


def _climb(goal: Goal, z: np.ndarray, iterations: int, chosen: np.ndarray | None, tol: float) -> Climb:
    """The steps, as what they ask for: (z, loss) at the end."""
    chosen = np.ones(z.size, bool) if chosen is None else chosen
    low, high = goal.evaluator.unknowns.box
    damping = 1e-3
    for _ in range(iterations):
        r, jacobian, _ = yield Ask(z, True)
        loss, normal, gradient = goal.linear(z, r, jacobian)
        if not (np.isfinite(loss) and np.isfinite(normal).all()):
            return z, loss
        free = chosen & ~((z <= low) & (gradient > 0)) & ~((z >= high) & (gradient < 0))
        if not free.any() or loss < 1e-24 or goal.gain(loss, normal, gradient, free) < tol:
            return z, loss
        trial, gain, damping = yield from _better(goal, z, loss, normal, gradient, free, damping)
        if trial is None:
            return z, loss
        moved, z = np.abs(trial - z).max(), trial
        if gain < tol or moved < 1e-8:
            return z, loss * (1 - gain)
    r, *_ = yield Ask(z, False)
    return z, goal.value(z, r)


def _better(
    goal: Goal, z: np.ndarray, loss: float, normal: np.ndarray, gradient: np.ndarray, free: np.ndarray, damping: float
) -> Generator[Ask, Any, tuple[np.ndarray | None, float, float]]:
    """A point with less loss: (z or None, share of the loss gained, next damping)."""
    low, high = goal.evaluator.unknowns.box
    for _ in range(8):
        step = np.zeros_like(z)
        step[free] = _damped_step(normal[np.ix_(free, free)], gradient[free], damping)
        longest = np.array([each.transform.longest for each in goal.evaluator.unknowns.constants])
        shorter = min(1.0, 1 / max((np.abs(step) / longest).max(), 1e-300))  # all of it, to go where the model says
        trial = np.clip(z + shorter * step, low, high)
        r, *_ = yield Ask(trial, False)
        new = goal.value(trial, r)
        if new < loss:
            return trial, 1 - new / loss, max(damping / 10, 1e-12)
        if np.abs(trial - z).max() < 1e-8:
            break
        damping *= 10
    return None, 0.0, damping


def _damped_step(normal: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    diagonal = np.diag(normal)
    # An unknown that the data do not see yet must not run away: its diagonal entry is kept off zero.
    scale = np.maximum(diagonal, 1e-6 * diagonal.max() + np.finfo(float).tiny)
    return np.asarray(np.linalg.solve(normal + damping * np.diag(scale), -gradient))
