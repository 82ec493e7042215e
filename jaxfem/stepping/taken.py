"""A step as the model's method takes it, and whether what the method gives back is one: seen while it is traced."""

import dataclasses
from typing import Any

import jax

from jaxfem.answers import COUNT, alike, described, flaw_of, odd_leaf
from jaxfem.batching import one_trace
from jaxfem.methods.base import SOLVED
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.stepping.checks import StepError

Array = jax.Array

TOLD = {**SOLVED, "inverted": COUNT}
"""What each step's info tells."""


def prepared(model: Model, params: Params, state: State, dt: Array) -> Any:
    """What the model's method prepares; StepError names the method where that cannot be kept."""
    found = model.method.prepare(model, params, state, dt)
    if (odd := odd_leaf(found)) is not None:
        raise StepError(
            f'`prepare{odd[0]}` of the method "{model.method.name}" gives {described(odd[1])}; it must give a tree of '
            "arrays, or None"
        )
    return found


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
    after, info = found
    for name in (field.name for field in dataclasses.fields(State) if field.name != "memory"):
        was, now = getattr(before, name), getattr(after, name)
        if not alike(was, now):
            return f"{name} = {_in_words(now)}; it must stay {_in_words(was)}, as in the state that it was given"
    if flaw := flaw_of(info, TOLD):
        return f"an info whose {flaw}"
    if (odd := odd_leaf(info)) is not None:
        return f"info{odd[0]} = {described(odd[1])}; it must be an array"
    return ""


def _in_words(tree: Any) -> str:
    """What a part of a state is: an array by its shape and type, or what it is made of."""
    return str(jax.tree.map(described, tree)) if jax.tree.leaves(tree) else described(tree)


def check_memory(model: Model, before: State, after: State) -> None:
    """StepError where a step leaves another memory than it found, so that none can follow it in a run."""
    if not alike(before.memory, after.memory):
        pair = (jax.tree.map(described, each.memory) for each in (before, after))
        raise StepError(
            f'`step` of the method "{model.method.name}" gives another memory than it found: structure, shapes and '
            "types must stay those of `start`, so that steps can follow each other; {} before, {} after".format(*pair)
        )
