"""Simulations of a fit with lanes last (`jaxfem.sweeping.lanes`): several points a chunk, or the columns of one.

A simulation with derivatives costs a chunk one run and as much again for each direction. So several points share the
directions, one after another, and of a single point each column is a lane with a direction of its own.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.fitting.objective import (
    Outcome,
    Plan,
    Problem,
    difference,
    frames_needed,
    keeping,
    scene_at,
    simulated,
)
from jaxfem.model import Model, Params, State
from jaxfem.sweeping.engines.base import Task
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.watching import watched, watched_changes

Array = jax.Array
POINT = "z"


def task_of(problem: Problem, plan: Plan) -> Task:
    """A simulation as a sweep's, of variants that are points z (P,)."""

    def change(_: Any, __: Any, values: dict[str, Array]) -> Any:
        return scene_at(values[POINT], problem, plan)

    dt: Any = problem.dt
    steps = plan.frames * plan.every
    return Task(*_scene(problem), dt, steps, plan.every, (), lambda _: {}, change)


def _scene(problem: Problem) -> tuple[Model, Params, State]:
    return problem.model, problem.params, problem.state


@partial(jax.jit, static_argnames="plan")
def residuals(z: Array, problem: Problem, plan: Plan, body: Body) -> tuple[Array, Outcome]:
    """As `objective.residuals`, at points z (S, P)."""
    count, keep = frames_needed(problem, plan), keeping(problem, plan)
    frames, status = watched(task_of(problem, plan), _scene(problem), body, {POINT: z}, count, keep)
    found: tuple[Array, Outcome] = jax.vmap(
        lambda own, kept, status: difference(own, kept, status, problem, plan), in_axes=(0, -1, -1)
    )(z, frames, status)
    return found


@partial(jax.jit, static_argnames="plan")
def linearised_of_many(z: Array, problem: Problem, plan: Plan, body: Body) -> tuple[Array, Array, Outcome]:
    """As `objective.linearised`, at points z (S, P)."""
    own = _directions(z, plan)
    along = jnp.broadcast_to(own[:, None], (len(own), *z.shape))
    frames, status, changes = _changes(z, along, problem, plan, body)
    found: tuple[Array, Array, Outcome] = jax.vmap(
        lambda own, kept, status, change: _columns(own, kept, status, change, problem, plan), in_axes=(0, -1, -1, -1)
    )(z, frames, status, changes)
    return found


@partial(jax.jit, static_argnames="plan")
def linearised(z: Array, problem: Problem, plan: Plan, body: Body) -> tuple[Array, Array, Outcome]:
    """As `objective.linearised`, at z (P,)."""
    own = _directions(z, plan)
    same = jnp.broadcast_to(z, own.shape)
    frames, status, changes = _changes(same, own[None], problem, plan, body)
    return _columns(z, frames[..., 0], status[0], jnp.moveaxis(changes[0], -1, 0), problem, plan)


def _changes(z: Array, directions: Array, problem: Problem, plan: Plan, body: Body) -> tuple[Array, Array, Array]:
    count, keep = frames_needed(problem, plan), keeping(problem, plan)
    points, along = {POINT: z}, {POINT: directions}
    return watched_changes(task_of(problem, plan), _scene(problem), body, points, along, count, keep)


def _directions(z: Array, plan: Plan) -> Array:
    """The unit direction of each of them, (D, P)."""
    return jnp.eye(z.shape[-1], dtype=z.dtype)[simulated(plan)]


def _columns(
    z: Array, frames: Array, status: Array, changes: Array, problem: Problem, plan: Plan
) -> tuple[Array, Array, Outcome]:
    """Residuals and Jacobian (P, T, M, 3) of what was kept of one point's frames (n, M, k), which have `changes`
    (D, n, M, k) along the directions of a simulation and none along the others."""
    every = jnp.zeros((z.size, *frames.shape), frames.dtype).at[simulated(plan)].set(changes)

    def along(direction: Array, change: Array) -> Array:
        compare = lambda own, kept: difference(own, kept, status, problem, plan)[0]  # noqa: E731
        pushed: Array = jax.jvp(compare, (z, frames), (direction, change))[1]
        return pushed

    r, outcome = difference(z, frames, status, problem, plan)
    return r, jax.vmap(along)(jnp.eye(z.size, dtype=z.dtype), every), outcome
