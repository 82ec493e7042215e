"""How the simulations of a fit are made: chosen with `fit(engine=...)`, told by `FitResult.engine` and `reason`."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import jax

from jaxfem.fitting import lanes, objective
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.objective import Outcome, Plan, Problem
from jaxfem.sweeping.engines import ENGINES as SWEEPS
from jaxfem.sweeping.lanes.body import Body, body_of

Array = jax.Array
Found = tuple[Array, Outcome]
Linear = tuple[Array, Array, Outcome]
AUTO = "auto"
LANES, MOST = 8, 32  # points a chunk: a multiple of the first, at most the second
PAYS = 150_000
"""Elements times steps, and twice that for each further start, from which on a fit with some five Jacobians a start
saves more time than its programs take longer to compile (10 to 20 s)."""
SHORT = 10_000
"""Elements times steps below which simulations of a whole fit take less than one more program takes to compile."""
BODY = 20
"""Elements that a rigid body counts as, with its rows."""


@dataclasses.dataclass(frozen=True)
class Engine:
    """By `rollout`'s step, what is several side by side by `vmap`: for every scene. `width`: points a program; `whole`:
    whether derivatives are made where residuals are asked for, so that one program serves both."""

    name: ClassVar[str] = "vmap"
    width: int = 8
    whole: bool = False

    def residuals(self, z: Array, problem: Problem, plan: Plan) -> Found:
        """At a point z (P,)."""
        found: Found = objective.residuals(z, problem, plan)
        return found

    def linearised(self, z: Array, problem: Problem, plan: Plan) -> Linear:
        """The same with the Jacobian."""
        found: Linear = objective.linearised(z, problem, plan)
        return found

    def residuals_of_many(self, z: Array, problem: Problem, plan: Plan) -> Found:
        """At points z (S, P)."""
        found: Found = objective.residuals_of_many(z, problem, plan)
        return found

    def linearised_of_many(self, z: Array, problem: Problem, plan: Plan) -> Linear:
        """The same with the Jacobians."""
        found: Linear = objective.linearised_of_many(z, problem, plan)
        return found


@dataclasses.dataclass(frozen=True)
class LanesLast(Engine):
    """With lanes last: `body` is what all points share of a scene."""

    name: ClassVar[str] = "lanes"
    width: int = 32
    body: Body | None = None

    def residuals(self, z: Array, problem: Problem, plan: Plan) -> Found:
        """A chunk of one."""
        found: Found = jax.tree.map(lambda leaf: leaf[0], lanes.residuals(z[None], problem, plan, self.body))
        return found

    def linearised(self, z: Array, problem: Problem, plan: Plan) -> Linear:
        """Each column is a lane."""
        found: Linear = lanes.linearised(z, problem, plan, self.body)
        return found

    def residuals_of_many(self, z: Array, problem: Problem, plan: Plan) -> Found:
        """A chunk."""
        found: Found = lanes.residuals(z, problem, plan, self.body)
        return found

    def linearised_of_many(self, z: Array, problem: Problem, plan: Plan) -> Linear:
        """A chunk whose points share the directions."""
        found: Linear = lanes.linearised_of_many(z, problem, plan, self.body)
        return found


ENGINES = {each.name: each for each in (Engine, LanesLast)}
Simulated = Sequence[tuple[Problem, Plan]]


def chosen(asked: str, simulated: Simulated, starts: int) -> tuple[list[Engine], str]:
    """The engine of each of the simulations, and why; `starts`: how many are followed together. FitError for one that
    is unknown, or asked for and cannot serve."""
    if asked not in (AUTO, *ENGINES):
        raise FitError(f"engine is {asked!r}; known: {', '.join((AUTO, *ENGINES))}")
    refused = next((words for problem, plan in simulated if (words := _refused(problem, plan))), None)
    if asked == LanesLast.name and refused:
        raise FitError(f'engine "{asked}" {refused}: give engine = "{AUTO}"')
    if asked == Engine.name:
        return _usual(simulated, starts), "asked for"
    if asked == AUTO:
        if jax.devices()[0].platform != "cpu":
            return _usual(simulated, starts), "accelerators take all points side by side"
        refused = refused or _slower(simulated, starts)
        if refused:
            return _usual(simulated, starts), f'engine "{LanesLast.name}" {refused}'
    width = LANES * min(-(-max(starts, 1) // LANES), MOST // LANES)
    bodies: dict[int, Body] = {}
    for problem, _ in simulated:
        if id(problem.model) not in bodies:
            bodies[id(problem.model)] = body_of(problem.model, problem.params)
    engines: list[Engine] = [LanesLast(width, body=bodies[id(problem.model)]) for problem, _ in simulated]
    return engines, "asked for" if asked != AUTO else "soft bodies on CPUs"


def _usual(simulated: Simulated, starts: int) -> list[Engine]:
    return [Engine(whole=starts == 0 and short(simulated)) for _ in simulated]


def short(simulated: Simulated) -> bool:
    """Whether all simulations of a fit take less than one more program takes to compile."""
    return sum(_work(problem, plan) for problem, plan in simulated) < SHORT


def _work(problem: Problem, plan: Plan) -> int:
    rigid = problem.params.rigid
    bodies = 0 if rigid is None else len(rigid.mass)
    return int((problem.model.elements.count + BODY * bodies) * plan.frames * plan.every)


def _refused(problem: Problem, plan: Plan) -> str | None:
    """Why lanes cannot serve a simulation, in words that follow their name, or None."""
    if plan.at_once is not None:
        return "makes all columns of a Jacobian together, and max_memory asks for some at a time"
    found: str | None = SWEEPS[LanesLast.name].made().refuses(lanes.task_of(problem, plan))
    return found


def _slower(simulated: Simulated, starts: int) -> str | None:
    """Why something else is faster, in words that follow their name, or None."""
    for problem, plan in simulated:
        if found := SWEEPS[LanesLast.name].made().slower(lanes.task_of(problem, plan)):
            return str(found)
    work = sum(problem.model.elements.count * plan.frames * plan.every for problem, plan in simulated) * (
        1 + 2 * starts
    )
    return "takes longer to compile than it saves in a fit as short as this" if work < PAYS else None
