"""Chunks of lanes of which little is kept, as fits do: what is seen of each frame, and how that changes, forwards.

As in `stepping.frames.watched` a lane goes on behind a step that did not converge, and the largest status is told.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.model import Model, Params, State
from jaxfem.solvers.status import Status
from jaxfem.sweeping.engines.base import Task
from jaxfem.sweeping.lanes.beside import lanewise, state_of
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.derivatives import Floats, changing, floats_of, with_floats
from jaxfem.sweeping.lanes.run import Begun, Values, begin, one
from jaxfem.sweeping.lanes.steps import Moving

Array = jax.Array
Keep = Callable[[State], Array]


def watched(
    task: Task, parts: tuple[Model, Params, State], body: Body, values: Values, count: Array, keep: Keep
) -> tuple[Array, Array]:
    """`keep(state)` (k + 1, ..., lanes) of the start and of `count` of the task's k frames, and the largest status
    (lanes,); what is behind `count`, which is no part of the program, is zero."""
    model, look = parts[0], _look(body, keep)
    begun = begin(task, model, parts, body, values)

    def a_step(_: Array, carry: Any) -> Any:
        at, worst = carry
        following, now = one(model, body, begun, at)
        return _on(begun, following), jnp.maximum(worst, now.status)

    def a_frame(number: Array, carry: Any) -> Any:
        at, worst, saved = carry
        at, worst = jax.lax.fori_loop(0, task.every, a_step, (at, worst))
        return at, worst, saved.at[number + 1].set(look(at))

    carry = begun.at, begun.at.failed, _rows(task, look(begun.at))
    _, worst, saved = jax.lax.fori_loop(0, count, a_frame, carry)
    return saved, worst


def watched_changes(
    task: Task,
    parts: tuple[Model, Params, State],
    body: Body,
    values: Values,
    directions: Values,
    count: Array,
    keep: Keep,
) -> tuple[Array, Array, Array]:
    """`watched`, with the changes (D, k + 1, ..., lanes) of what is kept along `directions` (D, lanes, ...) of the
    values; each step is made linear once, and they go through that one after another."""
    model, look = parts[0], _look(body, keep)
    begun = begin(task, model, parts, body, values)

    def start(values: Values) -> tuple[Floats, Floats]:
        made = begin(task, model, parts, body, values)
        return floats_of(made), floats_of(made.at)

    own, first = jax.lax.map(jax.linearize(start, values)[1], directions)
    taken = changing(model, body, begun, own)

    def looked(at: Moving, moving: Floats) -> tuple[Array, Array]:
        seen, push = jax.linearize(lambda floats: look(with_floats(at, floats)), floats_of(at))
        return seen, jax.lax.map(push, moving)

    def a_step(_: Array, carry: Any) -> Any:
        at, worst, moving = carry
        at, now, moving = taken(at, moving)
        return _on(begun, at), jnp.maximum(worst, now.status), moving

    def a_frame(number: Array, carry: Any) -> Any:
        at, worst, moving, saved, changes = carry
        at, worst, moving = jax.lax.fori_loop(0, task.every, a_step, (at, worst, moving))
        seen, change = looked(at, moving)
        return at, worst, moving, saved.at[number + 1].set(seen), changes.at[:, number + 1].set(change)

    seen, change = looked(begun.at, first)
    blank = jnp.moveaxis(_rows(task, jnp.moveaxis(change, 0, -1)), -1, 0)
    carry = begun.at, begun.at.failed, first, _rows(task, seen), blank
    _, worst, _, saved, changes = jax.lax.fori_loop(0, count, a_frame, carry)
    return saved, worst, changes


def _look(body: Body, keep: Keep) -> Callable[[Moving], Array]:
    """`keep` of all lanes."""
    found: Callable[[Moving], Array] = lanewise(lambda at: keep(state_of(body, at)))
    return found


def _rows(task: Task, first: Array) -> Array:
    """Room for all frames behind the first."""
    blank = jnp.zeros((task.steps // task.every + 1, *first.shape), first.dtype)
    return blank.at[0].set(first)


def _on(begun: Begun, at: Moving) -> Moving:
    """Lanes that go on: all but those that began with a status, or whose numbers are no longer finite."""
    lost = at.failed == int(Status.NOT_FINITE)
    return at.replace(failed=jnp.where(lost, at.failed, begun.at.failed))
