"""Derivatives of a chunk of lanes: forwards beside the steps, or backwards through their states."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.model import Model, Params, State
from jaxfem.solvers.differentiation import recomputed
from jaxfem.sweeping.derivatives import floating, forwards, jacobians, units
from jaxfem.sweeping.engines.base import Kept, Task
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.run import Begun, Values, begin, blank, ended, frames, keep, one, worse
from jaxfem.sweeping.lanes.steps import Moving, Told

Array = jax.Array
Floats = list[Array]
LANES = 1  # axis of lanes before those of values and outputs


def run_with_derivatives(task: Task, parts: tuple[Model, Params, State], body: Body, values: Values) -> Kept:
    """What is kept of a chunk, with the derivatives that the task asks for."""
    varied = {name: values[name] for name in task.derivatives}

    def whole(varied: Values) -> Kept:
        begun = begin(task, parts[0], parts, body, {**values, **varied})
        return keep(task, parts[0], body, begun, *frames(task, parts[0], body, begun))

    outputs = floating(jax.eval_shape(whole, varied)[0])
    way = _forwards if forwards(varied, outputs) else _backwards
    return way(task, parts, body, values, varied)


def _forwards(task: Task, parts: Any, body: Body, values: Values, varied: Values) -> Kept:
    """Each step is made linear once, and all directions go through that one after another."""
    model = parts[0]
    begun = begin(task, model, parts, body, values)

    def start(varied: Values) -> tuple[Floats, Floats]:
        made = begin(task, model, parts, body, {**values, **varied})
        return floats_of(made), floats_of(made.at)

    own, first = jax.lax.map(jax.linearize(start, varied)[1], units(varied, LANES))
    constants, taken = floats_of(begun), changing(model, body, begun, own)

    def inner(carry: Any, _: None) -> tuple[Any, None]:
        at, worst, moving = carry
        at, now, moving = taken(at, moving)
        return (at, worse(worst, now), moving), None

    def frame(carry: Any, _: None) -> Any:
        at, moving = carry
        (at, worst, moving), _ = jax.lax.scan(inner, (at, blank(model, at), moving), None, length=task.every)
        return (at, moving), (at, ended(body, at, worst), moving)

    _, (saved, infos, moving) = jax.lax.scan(frame, (begun.at, first), None, length=task.steps // task.every)

    def kept(constants: Floats, floats: Floats) -> Any:
        outputs, told = keep(task, model, body, with_floats(begun, constants), with_floats(saved, floats), infos)
        return floating(outputs), outputs, told

    (_, outputs, told), push = jax.linearize(kept, constants, floats_of(saved))
    moving = [jnp.moveaxis(each, 0, 1) for each in moving]
    changes = jax.lax.map(lambda each: push(*each)[0], (own, moving))
    return {**outputs, **jacobians(changes, varied, LANES, back=False)}, told


def changing(model: Model, body: Body, begun: Begun, own: Floats) -> Callable[[Moving, Floats], Any]:
    """A step of (at, its changes), with what is told of it between: (at, told, changes), along each of the directions
    that `own` has of the floats of `begun`."""
    constants = floats_of(begun)

    def taken(at: Moving, moving: Floats) -> tuple[Moving, Told, Floats]:
        def step(constants: Floats, floats: Floats) -> tuple[Floats, Array, Told]:
            following, now = one(model, body, with_floats(begun, constants), with_floats(at, floats))
            return floats_of(following), following.failed, now

        (floats, failed, now), push = jax.linearize(step, constants, floats_of(at))
        moving = jax.lax.map(lambda each: push(*each)[0], (own, moving))
        return with_floats(at, floats).replace(failed=failed), now, moving

    return taken


def _backwards(task: Task, parts: Any, body: Body, values: Values, varied: Values) -> Kept:
    """Of each step its state and solution are kept, all else is computed again."""
    model = parts[0]

    def run(varied: Values) -> Any:
        begun = begin(task, model, parts, body, {**values, **varied})
        outputs, told = keep(task, model, body, begun, *frames(task, model, body, begun, recomputed))
        return floating(outputs), (outputs, told)

    small, pull, (outputs, told) = jax.vjp(run, varied, has_aux=True)
    changes = jax.lax.map(lambda unit: pull(unit)[0], units(small, LANES))
    return {**outputs, **jacobians(changes, small, LANES, back=True)}, told


def floats_of(tree: Any) -> Floats:
    """Leaves that can have derivatives."""
    return [leaf for leaf in jax.tree.leaves(tree) if _is_float(leaf)]


def with_floats(tree: Any, floats: Floats) -> Any:
    """The tree with those leaves."""
    leaves, structure = jax.tree.flatten(tree)
    given = iter(floats)
    return jax.tree.unflatten(structure, [next(given) if _is_float(leaf) else leaf for leaf in leaves])


def _is_float(leaf: Any) -> bool:
    return bool(jnp.issubdtype(jnp.result_type(leaf), jnp.floating))
