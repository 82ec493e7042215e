"""Runs that are written as they go: one program takes any number of steps, what serves all of them is made once."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.energies import energies
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import Pytree
from jaxfem.stepping.begin import begun
from jaxfem.stepping.checks import check_call, check_rollout
from jaxfem.stepping.entering import typed
from jaxfem.stepping.step import cached, joined, one_step, one_that_ends
from jaxfem.stepping.values import value_status
from jaxfem.tensors import contract

Array = jax.Array


def begin(model: Model, params: Params, state: State, dt: Any) -> tuple[Model, State]:
    """The model with what its method prepares for steps of `dt` [s], and the state as a first step finds it."""
    cache, state = _begin(model, params, state, jnp.asarray(dt, model.rest.dtype))
    return model.replace(cache=cache), state


@jax.jit
def _begin(model: Model, params: Params, state: State, dt: Array) -> tuple[Any, State]:
    state = begun(model, params, state, None)
    return cached(model, params, state, dt), state


class Watch(Pytree):
    """Material points to follow from step to step: `nodes` (q, 4) of their elements and `weights` (q, 4)."""

    nodes: Array
    weights: Array


class Seen(Pytree):
    """What is told of each step: `time` [s], `energies` [J] by kind, `places` (q, 3) [m] of the points followed."""

    time: Array
    energies: dict[str, Array]
    places: Array


def frames(
    model: Model,
    params: Params,
    state: State,
    dt: Any,
    count: int,
    every: int,
    *,
    most: int,
    halvings: int = 0,
    watch: Watch | None = None,
    rows: int = 0,
) -> tuple[State, StepInfo, Seen | None]:
    """`count` <= `most` frames, each after `every` steps of `dt` [s]: what `rollout` returns, in arrays of `most` rows.

    Rows behind `count` are zero. A step that fails is taken in halves `halvings` times, then the run stops there. With
    `watch` also what is seen of each step, in arrays of `rows`, at least all steps taken. Only `most`, `halvings` and
    `rows` are part of the program: other counts compile nothing.
    """
    dtype = model.rest.dtype
    counts = jnp.int32(count), jnp.int32(every)
    saved: tuple[State, StepInfo, Seen | None]
    saved = _frames(model, params, state, jnp.asarray(dt, dtype), *counts, watch, most, halvings, rows)
    return saved


@partial(jax.jit, static_argnames=("most", "halvings", "rows"))
def _frames(
    model: Model,
    params: Params,
    state: State,
    dt: Array,
    count: Array,
    every: Array,
    watch: Watch | None,
    most: int,
    halvings: int,
    rows: int,
) -> tuple[State, StepInfo, Seen | None]:
    given = value_status(model, params, state, dt)
    state = begun(model, params, state, None)
    one = one_that_ends(model, params, dt, None, cached(model, params, state, dt), given, halvings)
    (start, _), told = jax.eval_shape(one, (state, jnp.int32(0)), None)
    # What the first step may add to a state, such as an estimate of some kind, must be there from the start.
    state = jax.tree.map(lambda leaf, like: jnp.asarray(leaf, like.dtype), state, start)

    def a_step(number: Array, carry: Any) -> Any:
        reached, info, seen = carry
        reached, found = one(reached, None)
        if watch is not None:
            seen = _set(seen, number, _seen(model, params, reached[0], watch))
        return reached, joined(info, found), seen

    def a_frame(number: Array, carry: Any) -> Any:
        reached, saved, seen = carry
        steps = number * every, (number + 1) * every
        reached, info, seen = jax.lax.fori_loop(*steps, a_step, (reached, _empty(told), seen))
        return reached, _set(saved, number, (reached[0], info)), seen

    seen = None if watch is None else _blank(jax.eval_shape(_seen, model, params, start, watch), rows)
    carry = (state, jnp.int32(0)), _blank((start, told), most), seen
    _, saved, seen = jax.lax.fori_loop(0, count, a_frame, carry)
    return *saved, seen


def watched(
    model: Model,
    params: Params,
    state: State,
    dt: Any,
    count: Array,
    every: int,
    *,
    most: int,
    keep: Callable[[State], Array],
) -> tuple[Array, Array]:
    """`keep(state)` of `count` <= `most` frames, each after `every` steps of `dt` [s], in `most` rows, and the largest
    status of their steps.

    Nothing else is held, so that a long run takes little memory. For use inside compiled functions, and for derivatives
    forwards; `count` is no part of the program.
    """
    params, state, dt_, _ = typed(model, params, state, dt, None)
    check_call(model, params, state, dt, None)
    check_rollout(most * every, every, None)
    given = value_status(model, params, state, dt_)
    state = begun(model, params, state, None)
    one = one_step(model, params, dt_, None, cached(model, params, state, dt_), given)

    def a_step(_: Array, carry: Any) -> Any:
        reached, status = carry
        reached, info = one(reached, None)
        return reached, jnp.maximum(status, info.status)

    def a_frame(number: Array, carry: Any) -> Any:
        reached, saved = carry
        reached = jax.lax.fori_loop(0, every, a_step, reached)
        return reached, saved.at[number].set(keep(reached[0]))

    like = jax.eval_shape(keep, state)
    status = jax.eval_shape(one, state, None)[1].status
    carry = (state, jnp.zeros(status.shape, status.dtype)), jnp.zeros((most, *like.shape), like.dtype)
    (_, worst), saved = jax.lax.fori_loop(0, count, a_frame, carry)
    return saved, worst


def _seen(model: Model, params: Params, state: State, watch: Watch) -> Seen:
    places = contract("qa,qai->qi", watch.weights, state.positions[watch.nodes])
    return Seen(state.time, energies(model, params, state).kinds, places)


def _blank(shapes: Any, rows: int) -> Any:
    return jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape), leaf.dtype), shapes)


def _set(rows: Any, number: Array, row: Any) -> Any:
    return jax.tree.map(lambda all_, leaf: all_.at[number].set(leaf), rows, row)


def _empty(told: Any) -> Any:
    """An info that every other replaces."""
    return jax.tree.map(lambda leaf: jnp.full(leaf.shape, _least(leaf.dtype), leaf.dtype), told).replace(
        status=jnp.zeros(told.status.shape, told.status.dtype)
    )


def _least(dtype: Any) -> Any:
    return -jnp.inf if jnp.issubdtype(dtype, jnp.inexact) else jnp.iinfo(dtype).min
