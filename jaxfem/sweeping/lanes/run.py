"""Runs of a chunk of lanes: where they start, their steps, and what is kept of them."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import Pytree
from jaxfem.stepping.values import value_status
from jaxfem.sweeping.engines.base import Kept, Task, told
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.increments import Lane
from jaxfem.sweeping.lanes.steps import Moving, Told, first, inside_out, lane_of, step
from jaxfem.sweeping.outputs import Observed

Array = jax.Array
Values = dict[str, Array]


class Begun(Pytree):
    """A chunk before its first step: numbers of each variant and its start, all with lanes last."""

    params: Params
    state: State
    dt: Array
    lane: Lane
    at: Moving


def begin(task: Task, model: Model, parts: tuple[Model, Params, State], body: Body, values: Values) -> Begun:
    """The chunk of `values` (lanes, ...)."""

    def start(own: Values) -> Begun:
        params, state, dt = task.variant(parts, own)
        dt = jnp.asarray(dt, model.rest.dtype)
        status = value_status(model, params, state, dt, None)
        return Begun(params, state, dt, lane_of(model, body, params), first(model, body, params, state, status))

    begun: Begun = jax.vmap(start, out_axes=-1)(values)
    return begun


def blank(model: Model, at: Moving) -> Told:
    """Nothing told yet."""
    zeros = jnp.zeros(at.failed.shape, jnp.int32)
    return Told(at.failed, zeros, jnp.zeros(at.failed.shape, model.rest.dtype), zeros)


def one(model: Model, body: Body, begun: Begun, at: Moving) -> tuple[Moving, Told]:
    """A step of all lanes."""
    return step(model, body, begun.lane, begun.params, at, begun.dt)


def worse(before: Told, now: Told) -> Told:
    """The largest of both, with the last status: a lane's first failure stays."""
    pairs = ((before.iterations, now.iterations), (before.residual, now.residual), (before.inverted, now.inverted))
    return Told(now.status, *(jnp.maximum(a, b) for a, b in pairs))


def ended(body: Body, at: Moving, worst: Told) -> Told:
    """What is told of a frame at its end."""
    return worst.replace(inverted=jnp.maximum(worst.inverted, inside_out(body, at.positions)))


def frames(task: Task, model: Model, body: Body, begun: Begun, wrap: Any = lambda function: function) -> Any:
    """(saved states, told) of each frame (k, ..., lanes); `wrap`: what is made of a step's function."""

    def inner(carry: Any, _: None) -> tuple[Any, None]:
        at, worst = carry
        at, now = one(model, body, begun, at)
        return (at, worse(worst, now)), None

    taken = wrap(inner)

    def frame(at: Moving, _: None) -> tuple[Moving, tuple[Moving, Told]]:
        (at, worst), _ = jax.lax.scan(taken, (at, blank(model, at)), None, length=task.every)
        return at, (at, ended(body, at, worst))

    return jax.lax.scan(frame, begun.at, None, length=task.steps // task.every)[1]


def keep(task: Task, model: Model, body: Body, begun: Begun, saved: Moving, infos: Told) -> Kept:
    """What is kept of each lane, (lanes, ...)."""

    def kept(params: Params, state: State, dt: Array, saved: Moving, infos: Told) -> Kept:
        states = _states(body, state, saved)
        told_of = StepInfo(infos.status, infos.iterations, infos.residual, jnp.zeros_like(infos.status), infos.inverted)
        return task.measure(Observed(model, params, state, states, told_of, dt)), told(told_of)

    found: Kept = jax.vmap(kept, in_axes=-1)(begun.params, begun.state, begun.dt, saved, infos)
    return found


def _states(body: Body, start: State, saved: Moving) -> State:
    """Saved states of one lane in the model's order of nodes, (k, ...)."""
    count = saved.time.shape[0]
    every = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), start)
    accelerations = None if saved.accelerations is None else saved.accelerations[:, body.back]
    found: State = every.replace(
        positions=saved.positions[:, body.back],
        velocities=saved.velocities[:, body.back],
        accelerations=accelerations,
        time=saved.time,
        memory=every.memory if saved.impulses is None else saved.impulses,
    )
    return found
