"""A step as the model's method takes it, and whether what the method gives back is one: seen while it is traced."""

from typing import Any

import jax

from jaxfem.answers import alike, described
from jaxfem.batching import one_trace
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.stepping.checks import StepError

Array = jax.Array


@one_trace
def step_taken(
    model: Model, params: Params, state: State, dt: Array, forces: Array | None, cache: Any
) -> tuple[State, StepInfo]:
    """The method's step; StepError names the method where it gives back what is no state and info.

    Only structure, shapes and types are looked at, so nothing of it is compiled.
    """
    found: Any = model.method.step(model, params, state, dt, forces, cache)
    flaw = _flaw(found, state)
    if flaw:
        raise StepError(f'`step` of the method "{model.method.name}" gives {flaw}')
    following: tuple[State, StepInfo] = found
    return following


def _flaw(found: Any, before: State) -> str:
    pair = isinstance(found, tuple) and len(found) == 2
    if not pair or not isinstance(found[0], State) or not isinstance(found[1], StepInfo):
        return f"{described(found)}; it must give the next State and a StepInfo"
    after = found[0]
    for name in ("positions", "velocities", "time"):
        was, now = getattr(before, name), getattr(after, name)
        if not alike(was, now):
            return f"{name} = {described(now)}; they must stay {described(was)}, as in the state that it was given"
    return ""


def check_memory(model: Model, before: State, after: State) -> None:
    """StepError where a step leaves another memory than it found, so that none can follow it in a run."""
    if not alike(before.memory, after.memory):
        pair = (jax.tree.map(described, each.memory) for each in (before, after))
        raise StepError(
            f'`step` of the method "{model.method.name}" gives another memory than it found: structure, shapes and '
            "types must stay those of `start`, so that steps can follow each other; {} before, {} after".format(*pair)
        )
