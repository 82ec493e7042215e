"""Rows of joints and contacts beside the elastic ones: made and judged by the step's own functions, lane by lane.

They are few beside the elements, so `vmap` serves them; what is large, the elastic part of the step's system, is left
out of it, and so out of the program.
"""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.model import Model, Params, State
from jaxfem.rows.points import PointRows
from jaxfem.solvers.status import Status
from jaxfem.sweeping.lanes.body import Body
from jaxfem.system.coupled import configuration, coupled_system
from jaxfem.system.giving import gave_way
from jaxfem.system.holding import held, unmet
from jaxfem.system.momentum import kept
from jaxfem.system.piercing import piercing_status
from jaxfem.system.soft import System

Array = jax.Array
Impulses = OrderedDict[str, Array]


def lanewise(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` of one lane, on arrays with lanes last."""
    return jax.vmap(function, in_axes=-1, out_axes=-1)


def state_of(body: Body, at: Any) -> State:
    """The state of one lane from its `Moving`, nodes in the model's order; without a memory."""
    accelerations = None if at.accelerations is None else at.accelerations[body.back]
    return State(at.positions[body.back], at.velocities[body.back], at.time, accelerations=accelerations)


def system_beside(model: Model, body: Body, params: Params, at: Any, dt: Array) -> System:
    """The step's system of all lanes without its elastic rows, nodes in the model's order."""

    def one(params: Params, at: Any, dt: Array) -> System:
        system = coupled_system(model, params, state_of(body, at), dt)
        left_out: Any = None
        system = system.replace(elastic=(), pattern=left_out, max_iterations=left_out)
        typed: System = jax.tree.map(strict, system)
        return typed

    def strict(leaf: Array) -> Array:  # a branch takes what has no precision of its own for double
        return leaf.astype(model.rest.dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    made: System = body.fence(lambda: lanewise(one)(params, at, dt))
    return made


def on_free_nodes(body: Body, system: System) -> tuple[PointRows, ...]:
    """One lane's rows on its free nodes, which stand first in the body's order, without their hold on all others."""

    def placed(rows: PointRows) -> PointRows:
        moving = jnp.repeat(system.free[rows.triples], 3, axis=1)[:, None]
        triples = jnp.minimum(body.back[rows.triples], body.free_count - 1)
        return rows.replace(triples=triples, jacobian=rows.jacobian * moving, unknowns=body.free_count)

    return tuple(placed(rows) for rows in system.extra.values())


def momentum_kept(model: Model, body: Body, system: System, places: Array, v: Array, impulses: Impulses) -> Array:
    """Velocities (n, 3, lanes) with the momentum that free bodies keep, whatever joints and contacts do to them."""
    if model.drifting is None:
        return v

    def one(system: System, places: Array, v: Array, impulses: Impulses) -> Array:
        return kept(model, system, places[body.back], v[body.back], impulses)[body.order]

    found: Array = body.fence(lambda: lanewise(one)(system, places, v, impulses))
    return found


def judged(
    model: Model, body: Body, params: Params, system: System, before: Any, after: Any, dt: Array, status: Array
) -> Array:
    """The status (lanes,) given of a step, or where it is 0 that of its joints and contacts."""

    def one(params: Params, system: System, before: Any, after: Any, dt: Array, status: Array) -> Array:
        impulses, end = after.impulses, state_of(body, after)
        if model.joints:
            missed = unmet(model, system, end.velocities, impulses)
            status = held(model, params, configuration(end), end.velocities, missed, dt, status)
        gave = gave_way(model, system, impulses, dt)
        if gave is not None:
            status = jnp.where(status == int(Status.CONVERGED), gave, status)
        return piercing_status(model, state_of(body, before), status)

    found: Array = lanewise(one)(params, system, before, after, dt, status)
    return found
