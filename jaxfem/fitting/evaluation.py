"""The host's view of the objective: flat residuals in NumPy, a count of evaluations, the best point seen, a history."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.objective import Outcome, Plan, Problem, linearised, residuals
from jaxfem.fitting.unknowns import Unknowns
from jaxfem.solvers import Status

Progress = Callable[[str, int, float, dict[str, float]], None]


@dataclasses.dataclass(frozen=True)
class Visit:
    """One evaluation: `stage`, `iteration` (counted through the whole fit), `loss`, `values` of the parameters."""

    stage: str
    iteration: int
    loss: float
    values: dict[str, float]


class Evaluator:
    """Residuals (T, M, 3) and Jacobian (P, T, M, 3) at z, as float64 NumPy arrays; loss is their mean square.

    Keeps the `best` z by the full loss, so that an interrupted search still has an answer.
    """

    def __init__(self, problem: Problem, plan: Plan, unknowns: Unknowns, progress: Progress | None):
        self.problem, self.plan, self.unknowns, self.progress = problem, plan, unknowns, progress
        self.stage = "scan"
        self.history: list[Visit] = []
        self.best: np.ndarray | None = None
        self.best_loss = np.inf
        weights = np.asarray(problem.weights)
        self.samples = int(np.count_nonzero(weights))
        self.step_failures = 0

    def with_steps(self, every: int) -> "Evaluator":
        """The same fit with `every` steps a saved frame; the history is shared."""
        dt = self.problem.dt * self.plan.every / every
        other = Evaluator(
            self.problem.replace(dt=dt),
            dataclasses.replace(self.plan, every=every),
            self.unknowns,
            self.progress,
        )
        other.history = self.history
        return other

    def residual(self, z: np.ndarray) -> tuple[np.ndarray, Outcome]:
        """Residuals at z and the side results; infinite where the simulation left the finite numbers."""
        r, outcome = residuals(self._array(z), self.problem, self.plan)
        return self._seen(z, _or_infinite(r, outcome), outcome), outcome

    def linear(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, Outcome]:
        """Residuals, Jacobian and side results at z."""
        r, jacobian, outcome = linearised(self._array(z), self.problem, self.plan)
        return self._seen(z, _or_infinite(r, outcome), outcome), np.asarray(jacobian, np.float64), outcome

    def loss(self, r: np.ndarray) -> float:
        """Mean square of the residuals that are there; infinite where one is not finite."""
        return float(np.sum(r * r) / self.samples) if np.isfinite(r).all() else float("inf")

    def _array(self, z: np.ndarray) -> Any:
        return jnp.asarray(z, self.problem.model.rest.dtype)

    def _seen(self, z: np.ndarray, r: np.ndarray, outcome: Outcome) -> np.ndarray:
        loss = self.loss(r)
        self.step_failures += int(outcome.status != 0)
        if loss < self.best_loss:
            self.best, self.best_loss = np.array(z), loss
        visit = Visit(self.stage, len(self.history), loss, self.unknowns.values(z))
        self.history.append(visit)
        if self.progress is not None:
            self.progress(visit.stage, visit.iteration, visit.loss, visit.values)
        return r


def _or_infinite(r: Any, outcome: Outcome) -> np.ndarray:
    """Residuals; infinite where a step broke down, since a step that fails returns its guess, not a motion."""
    array = np.asarray(r, np.float64)
    broken = Status(int(outcome.status)) in (Status.NOT_FINITE, Status.NOT_POSITIVE_DEFINITE, Status.INVALID_VALUE)
    return np.full_like(array, np.inf) if broken else array
