"""Runs that are written as they go: one program takes any number of steps, what serves all of them is made once."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.stepping.begin import begun
from jaxfem.stepping.step import cached, joined, one_that_ends
from jaxfem.stepping.values import value_status

Array = jax.Array


def begin(model: Model, params: Params, state: State, dt: Any) -> tuple[Model, State]:
    """The model with what its method prepares for steps of `dt` [s], and the state as a first step finds it."""
    cache, state = _begin(model, params, state, jnp.asarray(dt, model.rest.dtype))
    return model.replace(cache=cache), state


@jax.jit
def _begin(model: Model, params: Params, state: State, dt: Array) -> tuple[Any, State]:
    state = begun(model, params, state, None)
    return cached(model, params, state, dt), state


def frames(
    model: Model, params: Params, state: State, dt: Any, count: int, every: int, *, most: int, halvings: int = 0
) -> tuple[State, StepInfo]:
    """`count` <= `most` frames, each after `every` steps of `dt` [s]: what `rollout` returns, in arrays of `most` rows.

    Rows behind `count` are zero. A step that fails is taken in halves `halvings` times, then the run stops there. Only
    `most` and `halvings` are part of the program: other counts compile nothing.
    """
    dtype = model.rest.dtype
    counts = jnp.int32(count), jnp.int32(every)
    saved: tuple[State, StepInfo] = _frames(model, params, state, jnp.asarray(dt, dtype), *counts, most, halvings)
    return saved


@partial(jax.jit, static_argnames=("most", "halvings"))
def _frames(
    model: Model, params: Params, state: State, dt: Array, count: Array, every: Array, most: int, halvings: int
) -> tuple[State, StepInfo]:
    given = value_status(model, params, state, dt)
    state = begun(model, params, state, None)
    one = one_that_ends(model, params, dt, None, cached(model, params, state, dt), given, halvings)
    (start, _), told = jax.eval_shape(one, (state, jnp.int32(0)), None)
    # What the first step may add to a state, such as an estimate of some kind, must be there from the start.
    state = jax.tree.map(lambda leaf, like: jnp.asarray(leaf, like.dtype), state, start)

    def a_step(_: Array, carry: Any) -> Any:
        reached, info = carry
        reached, found = one(reached, None)
        return reached, joined(info, found)

    def a_frame(number: Array, carry: Any) -> Any:
        reached, saved = carry
        reached, info = jax.lax.fori_loop(0, every, a_step, (reached, _empty(told)))
        row = (reached[0], info)
        return reached, jax.tree.map(lambda rows, leaf: rows.at[number].set(leaf), saved, row)

    saved = jax.tree.map(lambda leaf: jnp.zeros((most, *leaf.shape), leaf.dtype), (start, told))
    found: tuple[State, StepInfo] = jax.lax.fori_loop(0, count, a_frame, ((state, jnp.int32(0)), saved))[1]
    return found


def _empty(told: Any) -> Any:
    """An info that every other replaces."""
    return jax.tree.map(lambda leaf: jnp.full(leaf.shape, _least(leaf.dtype), leaf.dtype), told).replace(
        status=jnp.zeros(told.status.shape, told.status.dtype)
    )


def _least(dtype: Any) -> Any:
    return -jnp.inf if jnp.issubdtype(dtype, jnp.inexact) else jnp.iinfo(dtype).min
