"""Energy that leaves and enters a scene, booked step by step: losses, and the work of loads and motions.

Each entry is of second order in the step: trapezoids of forces along the way, and losses of an even strain rate.
"""

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import domain_strains
from jaxfem.elements.elasticity import viscoelastic_force
from jaxfem.loads import load_force
from jaxfem.model import Model, Params, State, domain_materials, element_constants, nodal_mass, shared_mass
from jaxfem.system.drag import nodal_drag
from jaxfem.system.memory import domain_values, soon, step_materials
from jaxfem.system.own_elasticity import own_elasticity
from jaxfem.tensors import inner

Array = jax.Array


def first_account(model: Model, params: Params, state: State) -> dict[str, Array]:
    """Nothing booked yet, one entry for each kind of loss or work that the scene may have."""
    shapes = jax.eval_shape(lambda: _entries(model, params, state, state, jnp.ones((), model.rest.dtype), None))
    return {name: jnp.zeros((), each.dtype) for name, each in shapes.items()}


def booked(
    model: Model, params: Params, before: State, after: State, dt: Array, forces: Array | None
) -> dict[str, Array] | None:
    """The account after a step of `dt` [s] from one state to another; None where none is kept."""
    if before.account is None:
        return None
    entries = _entries(model, params, before, after, dt, forces)
    return {name: before.account[name] + entries[name] for name in before.account}


def _entries(
    model: Model, params: Params, before: State, after: State, dt: Array, forces: Array | None
) -> dict[str, Array]:
    """What a step adds to each entry, () [J]."""
    way = after.positions - before.positions
    pull = [load_force(model.loads, params.loads, each.positions) for each in (before, after)]
    load = 0.5 * (pull[0] + pull[1]) + (0 if forces is None else forces)
    entries = {"loads": -inner(load, way)}
    if model.driven:
        entries["supports"] = -_support_work(model, params, before, after, load, dt)
    if model.dragged:
        entries["drag"] = inner(way, _drag(model, params, way / dt))
    return entries | _losses(model, params, before, after, dt)


def _drag(model: Model, params: Params, velocities: Array) -> Array:
    """Minus the force (n, 3) [N] of mass-proportional damping."""
    own = nodal_drag(model, params)[:, None] * velocities
    shared = shared_mass(model, params.density)
    momentum = nodal_mass(model, params.density)[:, None] * own
    return momentum if shared is None else momentum + shared.apply(own)


def _losses(model: Model, params: Params, before: State, after: State, dt: Array) -> dict[str, Array]:
    """What damping and the laws' memories lost, or the method's own elasticity did."""
    way = after.positions - before.positions
    own = own_elasticity(model, params, 0.5 * (before.positions + after.positions), way / dt)
    if own is not None:
        return {"damping": dt * own.power}
    strains = [domain_strains(model.domains, each.positions, model.rotation_kind) for each in (before, after)]
    values, zero = element_constants(model, params), jnp.zeros((), model.rest.dtype)
    losses = {"damping": zero}
    for k, (each, material) in enumerate(zip(model.domains, domain_materials(model, params), strict=True)):
        start, end = (jnp.stack(own[k][0]) for own in strains)
        weights = jnp.stack([jnp.broadcast_to(w, each.row_volumes.shape) for w in material.weights(each)])
        rate = material.damping * jnp.sum(weights * (end - start) ** 2, axis=0) / dt
        losses["damping"] += inner(each.row_volumes, rate)
        if before.internal is None or before.internal[k] is None:
            continue
        numbers = domain_values(each, values)
        found = each.law.dissipated(numbers, before.internal[k], after.internal[k], end, weights, dt, each.rows)
        for name, density in found.items():
            losses[name] = losses.get(name, zero) + inner(each.row_volumes, density)
    return losses


def _support_work(model: Model, params: Params, before: State, after: State, load: Array, dt: Array) -> Array:
    """Work of prescribed motions: what of the driven nodes' kinetic energy no other force accounts for."""
    mass, shared = nodal_mass(model, params.density)[:, None], shared_mass(model, params.density)
    change = after.velocities - before.velocities
    momentum = mass * change if shared is None else mass * change + shared.apply(change)
    way = after.positions - before.positions
    # Prescribed velocities are those of the middle of a step.
    inner = [_inner_force(model, params, each, way / dt) for each in (before, after)]
    others = load + 0.5 * (inner[0] + inner[1]) + mass * params.gravity
    if model.dragged:
        others = others - _drag(model, params, way / dt)
    driven = jnp.zeros((model.nodes, 1), way.dtype).at[jnp.concatenate(model.driven)].set(1)
    mean = 0.5 * (before.velocities + after.velocities)
    return jnp.sum(driven * (momentum * mean - others * way))


def _inner_force(model: Model, params: Params, state: State, rates: Array) -> Array:
    """Elastic and viscous force (n, 3) [N] at a state, whose nodes move at `rates` (n, 3)."""
    own = own_elasticity(model, params, state.positions, rates)
    if own is not None:
        force: Array = own.force
        return force
    materials = step_materials(model, params, state, soon(model.rest.dtype))
    return viscoelastic_force(model.domains, state.positions, rates, materials, model.rotation_kind)
