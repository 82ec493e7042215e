"""Starts for materials with a memory: what they remember of a shape that was not reached by steps."""

from typing import Any, Literal, get_args

import jax

from jaxfem.model import Model, Params, State
from jaxfem.stepping.checks import StepError, check_call
from jaxfem.stepping.entering import typed
from jaxfem.system.memory import memory_at

Start = Literal["relaxed", "instantaneous"]


def with_memory(model: Model, params: Params, state: State, start: Start = "relaxed") -> State:
    """The state with what its materials remember of its shape: how that came about before the run.

    `start`: "relaxed", held so for ever; or "instantaneous", taken at once just now, so that what relaxes starts with
    all of its stress. What has flowed is forgotten. Without materials with a memory nothing changes. Differentiable.
    Raises StepError for another `start`.
    """
    if start not in (known := get_args(Start)):
        raise StepError(f"start is {start!r}; give one of {', '.join(map(repr, known))}")
    params, state = typed(model, params, state)
    check_call(model, params, state, 1.0)
    if not model.has_memory:
        return state
    return state.replace(internal=_memory(model, params, state, start == "instantaneous"), accelerations=None)


def _made(model: Model, params: Params, state: State, at_once: bool) -> Any:
    return memory_at(model, params, state.positions, at_once)


_memory = jax.jit(_made, static_argnames="at_once")
