"""The host's view of the objective: residuals of all takes in NumPy, counts, the best point seen, a history."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.engines import Engine, chosen, short
from jaxfem.fitting.objective import Outcome, Plan, Problem
from jaxfem.fitting.priors import Priors
from jaxfem.fitting.unknowns import Unknowns
from jaxfem.solvers import Status

Progress = Callable[[str, int, float, dict[str, float]], None]
Arrays = list[np.ndarray]
Linear = tuple[list[np.ndarray], list[np.ndarray], list[Outcome]]
RECENT = 16  # points whose residuals are kept: stages of a search begin where others ended
BROKEN = (Status.NOT_FINITE, Status.NOT_POSITIVE_DEFINITE, Status.INVALID_VALUE)


@dataclasses.dataclass(frozen=True)
class Visit:
    """One evaluation: `stage`, `iteration` (counted through the whole fit), `loss`, `values` of the parameters;
    `derivatives`: whether the Jacobian was asked for too."""

    stage: str
    iteration: int
    loss: float
    values: dict[str, float]
    derivatives: bool = False


@dataclasses.dataclass(frozen=True)
class Piece:
    """One take as it is compiled: `problem`, `plan`, and which unknowns z are its own, `columns` (p,); `engine`: how it
    is simulated."""

    problem: Problem
    plan: Plan
    columns: np.ndarray
    engine: Engine = dataclasses.field(default_factory=Engine)

    def with_steps(self, every: int) -> "Piece":
        """The same with `every` steps a saved frame."""
        dt, plan = self.problem.dt * self.plan.every / every, dataclasses.replace(self.plan, every=every)
        return dataclasses.replace(self, problem=self.problem.replace(dt=dt), plan=plan)

    def until(self, share: float) -> "Piece":
        """The same with the samples of the first share of its time alone; what is behind them is not simulated."""
        times = np.asarray(self.problem.times, np.float64)
        there = times <= times[0] + share * (times[-1] - times[0])
        weights = jnp.where(there[:, None, None], self.problem.weights, 0)
        return dataclasses.replace(self, problem=self.problem.replace(weights=weights))

    def on(self, problem: Problem) -> "Piece":
        """The same with another problem; what engines know of a scene is of one model."""
        engine = self.engine if problem.model is self.problem.model else Engine(whole=short([(problem, self.plan)]))
        return dataclasses.replace(self, problem=problem, engine=engine)

    def residuals(self, z: np.ndarray) -> tuple[Any, Outcome]:
        """Its residuals at z (P,) of the fit."""
        return self.engine.residuals(self.at(z), self.problem, self.plan)

    def linearised(self, z: np.ndarray) -> tuple[Any, Any, Outcome]:
        """Its residuals at z (P,) of the fit, and their Jacobian in its own unknowns."""
        return self.engine.linearised(self.at(z), self.problem, self.plan)

    def of_many(self, z: np.ndarray, derivatives: bool) -> Any:
        """Either at points z (S, P)."""
        make: Any = self.engine.linearised_of_many if derivatives else self.engine.residuals_of_many
        return make(self.at(z), self.problem, self.plan)

    def at(self, z: np.ndarray) -> Any:
        """Its own unknowns, as its model takes them, of one point (P,) or several (S, P)."""
        return jnp.asarray(z[..., self.columns], self.problem.model.rest.dtype)

    def spread(self, own: Any, count: int) -> np.ndarray:
        """A Jacobian in its own unknowns as one in all `count` of the fit."""
        jacobian = np.zeros((count, *own.shape[1:]))
        jacobian[self.columns] = np.asarray(own, np.float64)
        return jacobian


@dataclasses.dataclass(frozen=True)
class Near:
    """Residuals `r` of all takes at `z` (P,), and their `jacobian` there, `made` there or corrected on the way."""

    z: np.ndarray
    r: Arrays
    jacobian: Arrays
    made: bool

    def stepped(self, z: np.ndarray, r: Arrays) -> "Near":
        """At the next point, where the residuals are r: the nearest Jacobian that tells them, unknowns measured by
        what they move."""
        step = z - self.z
        sizes = sum((each.reshape(len(each), -1) ** 2).sum(axis=1) for each in self.jacobian)
        share = sizes * step / max(float(step @ (sizes * step)), np.finfo(float).tiny)
        corrected = []
        for old, new, columns in zip(self.r, r, self.jacobian, strict=True):
            off = new - old - np.tensordot(step, columns, 1)
            corrected.append(columns + np.multiply.outer(share, off))
        return Near(z, r, corrected, False)


class Evaluator:
    """Residuals (T, M, 3) and Jacobians (P, T, M, 3) of each take at z, as float64 NumPy arrays.

    Keeps the `best` z by the full loss, the mean square of all residuals, so that an interrupted search still has an
    answer, and `near`, what the last climb knew where it ended. `variance`: of the noise, in the residuals' unit
    squared; by it `priors` are weighed against samples.
    """

    def __init__(
        self,
        pieces: Sequence[Piece],
        unknowns: Unknowns,
        progress: Progress | None = None,
        priors: Priors | None = None,
        variance: float = 1e-4,
    ):
        self.pieces, self.unknowns, self.progress = tuple(pieces), unknowns, progress
        self.priors, self.variance = priors, variance
        self.stage = "scan"
        self.history: list[Visit] = []
        self.best: np.ndarray | None = None
        self.best_loss = np.inf
        self.samples = int(sum(np.count_nonzero(np.asarray(each.problem.weights)) for each in pieces))
        self.step_failures = 0
        self.last: tuple[np.ndarray, Linear] | None = None
        self.made = -1  # which visit made the last derivatives
        self.near: Near | None = None
        self.recent: dict[bytes, tuple[Arrays, list[Outcome]]] = {}

    def take(self, engine: str, starts: int) -> str:
        """Have all pieces simulated by an engine, `starts` together at most; why by that."""
        engines, reason = chosen(engine, [(each.problem, each.plan) for each in self.pieces], starts)
        self.pieces = tuple(
            dataclasses.replace(piece, engine=own) for piece, own in zip(self.pieces, engines, strict=True)
        )
        return reason

    @property
    def whole(self) -> bool:
        """Whether derivatives come with all residuals."""
        return all(piece.engine.whole for piece in self.pieces)

    def with_steps(self, every: int) -> "Evaluator":
        """The same fit with `every` steps a saved frame; the history is shared."""
        pieces = [each.with_steps(every) for each in self.pieces]
        other = Evaluator(pieces, self.unknowns, self.progress, self.priors, self.variance)
        other.history = self.history
        return other

    def until(self, share: float) -> "Evaluator":
        """The same fit of the first share of each take; the history is shared."""
        pieces = [each.until(share) for each in self.pieces]
        other = Evaluator(pieces, self.unknowns, self.progress, self.priors, self.variance)
        other.history = self.history
        return other

    def apart(self, progress: Progress | None = None) -> "Evaluator":
        """The same fit with a history of its own, of which nobody else is told."""
        return Evaluator(self.pieces, self.unknowns, progress, self.priors, self.variance)

    def residual(self, z: np.ndarray) -> tuple[list[np.ndarray], list[Outcome]]:
        """Residuals at z and the side results, those made before where they are kept; infinite where a simulation left
        the finite numbers."""
        if kept := self.recent.get(_key(z)):
            return kept
        if self.whole:
            r, _, outcomes = self._linear(z, asked=False)
            return r, outcomes
        found = [each.residuals(z) for each in self.pieces]
        r = [_or_infinite(each, outcome) for each, outcome in found]
        return self._seen(z, r, [outcome for _, outcome in found]), [outcome for _, outcome in found]

    def linear(self, z: np.ndarray) -> Linear:
        """Residuals, Jacobians and side results at z; where they were made last, those."""
        if self.last is not None and np.array_equal(self.last[0], z):
            self.history[self.made] = dataclasses.replace(self.history[self.made], derivatives=True)
            return self.last[1]
        return self._linear(z, asked=True)

    def _linear(self, z: np.ndarray, asked: bool) -> Linear:
        found = [each.linearised(z) for each in self.pieces]
        outcomes = [outcome for *_, outcome in found]
        r = [_or_infinite(each, outcome) for each, _, outcome in found]
        jacobians = [piece.spread(own, z.size) for piece, (_, own, _) in zip(self.pieces, found, strict=True)]
        self.last = np.array(z), (self._seen(z, r, outcomes, asked), jacobians, outcomes)
        self.made = len(self.history) - 1
        return self.last[1]

    def together(self, points: Sequence[np.ndarray], derivatives: bool) -> list[Any]:
        """What `linear`, or without `derivatives` `residual`, says of each point, as many at a time as engines take."""
        width = min(piece.engine.width for piece in self.pieces)
        return [
            told
            for first in range(0, len(points), width)
            for told in self._chunk(points[first:][:width], derivatives, width)
        ]

    def _chunk(self, points: Sequence[np.ndarray], derivatives: bool, width: int) -> list[Any]:
        """Up to `width` points side by side, in one program for any number of them."""
        padded = np.array([*points, *[points[-1]] * (width - len(points))])
        parts = [jax.tree.map(np.asarray, each.of_many(padded, derivatives)) for each in self.pieces]
        found: list[Any] = []
        for lane, z in enumerate(points):
            mine = [jax.tree.map(lambda leaf, lane=lane: leaf[lane], part) for part in parts]
            outcomes = [part[-1] for part in mine]
            r = [_or_infinite(part[0], outcome) for part, outcome in zip(mine, outcomes, strict=True)]
            self._seen(z, r, outcomes, derivatives)
            if derivatives:
                columns = [piece.spread(part[1], z.size) for piece, part in zip(self.pieces, mine, strict=True)]
                found.append((r, columns, outcomes))
            else:
                found.append((r, outcomes))
        return found

    def loss(self, r: Sequence[np.ndarray] | np.ndarray) -> float:
        """Mean square of the residuals that are there; infinite where one is not finite."""
        arrays = [r] if isinstance(r, np.ndarray) else r
        if not all(np.isfinite(each).all() for each in arrays):
            return float("inf")
        return float(sum((each * each).sum() for each in arrays)) / max(self.samples, 1)

    def _seen(
        self, z: np.ndarray, r: list[np.ndarray], outcomes: Sequence[Outcome], derivatives: bool = False
    ) -> list[np.ndarray]:
        loss = self.loss(r)
        self.step_failures += int(any(int(each.status) != 0 for each in outcomes))
        if loss < self.best_loss:
            self.best, self.best_loss = np.array(z), loss
        visit = Visit(self.stage, len(self.history), loss, self.unknowns.values(z), derivatives)
        self.history.append(visit)
        if self.progress is not None:
            self.progress(visit.stage, visit.iteration, visit.loss, visit.values)
        self.recent[_key(z)] = r, list(outcomes)
        if len(self.recent) > RECENT:
            del self.recent[next(iter(self.recent))]
        return r


def _key(z: np.ndarray) -> bytes:
    """What names a point: points that differ by rounding alone are one."""
    return (np.round(np.asarray(z, np.float64), 12) + 0.0).tobytes()


def _or_infinite(r: Any, outcome: Outcome) -> np.ndarray:
    """Residuals; infinite where a step broke down, since a step that fails returns its guess, not a motion."""
    array = np.asarray(r, np.float64)
    return np.full_like(array, np.inf) if Status(int(outcome.status)) in BROKEN else array
