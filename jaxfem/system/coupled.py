"""A step of soft and rigid bodies, joints and contacts: one system on all triples.

Rigid bodies add two triples each to the unknown: linear velocities, then angular ones (world frame). The angular blocks
of the mass are the inertia I at the middle of the step plus, where it must be, dt^2 times the geometric stiffness of
the joints' pull: M' w = I w* + J' lam, w* the spin of the free body (`rigid/turning.py`). All joint and contact rows
follow the elastic ones.

With the second-order scheme (soft bodies only) joints and motors hold at its stage, as elastic rows do. Contacts,
limits and ropes keep the end-of-step velocity from closing the gap at the start, as in backward Euler: held at the
stage, velocities would turn about with each step. Where one of them strikes, the step is one of backward Euler for the
bodies that it may tie, whose accelerations then start anew: what an impact does to them would echo (cf. Chen, Acary,
Virlez & Bruls 2013).
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.indexing import with_last
from jaxfem.model import Model, Params, State, nodal_mass, nodal_stiffness
from jaxfem.rigid.dynamics import advanced, free_spin, midway, prescribed_velocities, world_inertia
from jaxfem.rotation import quaternion_to_matrix
from jaxfem.rows.attachments import Configuration
from jaxfem.rows.bounds import Friction
from jaxfem.rows.contact import Gaps, contact_rows
from jaxfem.rows.points import PointRows
from jaxfem.schemes import BackwardEuler, Stage
from jaxfem.system.carry import dropped_of
from jaxfem.system.impacts import gaps_of, island_slots, with_impacts
from jaxfem.system.momentum import turns_ahead
from jaxfem.system.names import contact_name, friction_name, joint_name
from jaxfem.system.pull import needed_stiffness, pulls
from jaxfem.system.soft import System, external_force, inverse_mass, stage_of, step_system
from jaxfem.system.unsolved import unsolved
from jaxfem.tensors import contract, inverse_blocks

Array = jax.Array
Inverse = tuple[Array, Array | None]

TRACE = {True: 1e-9, False: 1e-6}
"""Least compliance of a row, as a share of what a unit impulse on it moves it by, in double and in single precision."""
LEAST = 1e-3
"""Of a node's own inverse mass: the trace goes by no less, however stiff the material that holds the node."""


def coupled_system(
    model: Model,
    params: Params,
    state: State,
    dt: Array,
    forces: Array | None = None,
    pull: Mapping[str, Array] | None = None,
) -> System:
    """The step's system on all triples: n nodes, b linear, b angular.

    `pull`: impulses of rows by group, as far as known: what geometric stiffness is made of. Those of the last step, or
    where they grow of this one (see `pull.py`).
    """
    at = configuration(state)
    impact = unhindered = None
    if model.scheme.restarts:
        unhindered = _unhindered(model, params, state, dt, forces)
        impact = _impact(model, params, state, dt, unhindered, at)
    turns = turns_ahead(model, params, state, dt)
    soft = step_system(model, params, state, dt, forces, impact=impact, turns=turns)
    system = soft if model.rigid is None else _with_rigid(soft, model, params, state, dt, at, pull or {})
    elastic = tuple(each.replace(nodes=at.unknowns) for each in soft.elastic)
    stage = stage_of(model, state, soft.prescribed, dt, impact)
    reached = system.target if unhindered is None else unhindered
    extra, friction, gaps = _extra_rows(model, params, state, dt, stage, at, reached)
    inverse, passed = inverse_mass(system), None
    if model.islands is not None and model.rigid is not None and gaps:
        slots = island_slots(model.islands, model.rigid.free)
        velocities = (velocities_of(state), system.target)

        def moved(momenta: Array) -> Array:
            return apply_inverse_mass(inverse, momenta)

        extra, passed = with_impacts(extra, gaps, friction, slots, velocities, moved, state.memory, dt)
    hardened, traces = OrderedDict[str, PointRows](), {}
    held = (_held_mass(model, params, inverse[0], dt, LEAST), inverse[1])
    gives = _gives(model, params, inverse, held, dt)
    for name, rows in extra.items():
        least = gives[name](rows) if name in gives else None
        hardened[name], traces[name] = _hardened(rows, inverse, held, gaps.get(name), least)
    system = system.replace(elastic=elastic, extra=hardened, friction=friction, passed=passed)
    looked_at = [joint_name(label) for label in model.joints]
    if model.rigid is not None:
        looked_at += [contact_name(label) for label, group in model.contacts.items() if not group.give]
        looked_at += [friction_name(label) for label, group in model.contacts.items() if group.slip]
    return system.replace(trace={name: traces[name] for name in looked_at if name in traces})


@unsolved
def _extra_rows(
    model: Model, params: Params, state: State, dt: Array, stage: Stage, at: Configuration, unhindered: Array
) -> tuple[OrderedDict[str, PointRows], dict[str, Friction], dict[str, Gaps]]:
    """Rows of joints and contacts by group, which of them are friction's, and the gaps of those that strike.

    `unhindered` (n, 3): end-of-step velocities as they would be without any row.
    """
    ahead = at.replace(nodes=stage.base)
    striking = _plain_stage(state, dt).replace(weight=stage.weight)
    extra: OrderedDict[str, PointRows] = OrderedDict()
    gaps: dict[str, Gaps] = {}
    for label, group in sorted(model.joints.items()):
        place = (at, striking) if group.one_sided else (ahead, stage)
        extra[joint_name(label)] = group.rows(place[0], params.joints[label], place[1]).counted()
        if group.one_sided:
            gaps[joint_name(label)] = gaps_of(extra[joint_name(label)], dt)
    friction = {}
    for label, group in sorted(model.contacts.items()):
        values = params.contacts[label]
        normal, tangent, gaps[contact_name(label)] = contact_rows(
            group, at, values, dt, velocities_of(state), unhindered
        )
        extra[contact_name(label)] = normal
        if tangent is not None:
            friction[friction_name(label)] = Friction(values.friction, contact_name(label), group.cone)
            extra[friction_name(label)] = tangent
    return extra, friction, gaps


def _gives(
    model: Model, params: Params, inverse: Inverse, held: Inverse, dt: Array
) -> dict[str, Callable[[PointRows], Array]]:
    """By group of rows, of those contacts that ask for one: rows -> their least compliance (m, r).

    What says the same many times gives by a share of what its soft nodes do, with the material around them and without
    what is rigid: that is a share of how far the load presses them in, however heavy it is and whatever is between.
    What slips gives by a share of what both sides do.
    """
    found: dict[str, Callable[[PointRows], Array]] = {}
    soft = None
    for label, group in model.contacts.items():
        if group.slip > 0:
            found[friction_name(label)] = partial(_share, group.slip, held)
        if group.give > 0:
            if soft is None:
                firm = _held_mass(model, params, inverse[0], dt, 0.0).at[model.nodes :].set(0)
                soft = firm, None if inverse[1] is None else jnp.zeros_like(inverse[1])
            found |= dict.fromkeys((contact_name(label), friction_name(label)), partial(_share, group.give, soft))
    return found


def _share(share: float, inverse: Inverse, rows: PointRows) -> Array:
    return share * rows.diagonal(*inverse)


def _plain_stage(state: State, dt: Array) -> Stage:
    """Where contacts, limits and ropes act, whatever the scheme."""
    return BackwardEuler().stage(state, state.velocities, jnp.bool_(True), dt)


def _unhindered(model: Model, params: Params, state: State, dt: Array, forces: Array | None) -> Array:
    """Velocities (n, 3) of the nodes after a step without any row, with the acceleration that loads alone give."""
    load = external_force(model, params, state.positions, forces)
    return state.velocities + dt * load / nodal_mass(model, params.density)[:, None] * model.free[:, None]


def _impact(model: Model, params: Params, state: State, dt: Array, unhindered: Array, at: Configuration) -> Array:
    """Nodes (n,) of bodies where a one-sided row strikes: its rate changes by more than two steps of loads explain.

    `unhindered` as in `_extra_rows`.
    """
    rows, friction, _ = _extra_rows(model, params, state, dt, _plain_stage(state, dt), at, unhindered)
    assert model.node_group is not None
    struck = jnp.zeros(model.nodes, bool)  # by group, of which there are fewer
    for name, each in rows.items():
        if each.bounds is None or name in friction:
            continue
        before, coming = each.apply(state.velocities), each.apply(unhindered)
        for side, bound in ((1, each.bounds[1]), (-1, each.bounds[0])):
            short = side * (each.bias - before) > 2 * jnp.abs(coming - before)
            due = jnp.any(jnp.isinf(bound) & short & (side * (each.bias - coming) > 0), axis=1)
            struck = struck.at[model.node_group[each.triples[:, 0]]].max(due)
    return struck[model.node_group]


def velocities_of(state: State) -> Array:
    """Velocities of all triples at the start of the step."""
    if state.rigid is None:
        return state.velocities
    return jnp.concatenate([state.velocities, state.rigid.velocities, state.rigid.angular_velocities])


def configuration(state: State) -> Configuration:
    """Where everything is at the start of the step."""
    if state.rigid is None:
        zero = jnp.zeros((0, 3), state.positions.dtype)
        return Configuration(state.positions, zero, jnp.zeros((0, 3, 3), zero.dtype), dropped_of(state))
    rotations = quaternion_to_matrix(state.rigid.orientations)
    return Configuration(state.positions, state.rigid.positions, rotations, dropped_of(state))


def apply_inverse_mass(inverse: tuple[Array, Array | None], momentum: Array) -> Array:
    """M^-1 times (n, 3)."""
    scalar, blocks = inverse
    velocities = scalar[:, None] * momentum
    if blocks is None:
        return velocities
    return with_last(velocities, contract("bij,bj->bi", blocks, momentum[-blocks.shape[0] :]))


def apply_mass(system: System, velocities: Array) -> Array:
    """M times (n, 3) on all that moves freely."""
    momentum = (system.free * system.mass)[:, None] * velocities
    if system.inertia is None:
        return momentum
    bodies = system.inertia.shape[0]
    turning = contract("bij,bj->bi", system.inertia, velocities[-bodies:]) * system.free[-bodies:, None]
    return with_last(momentum, turning)


def midway_inertia(model: Model, params: Params, state: State, dt: Array) -> Array:
    """Inertia of the rigid bodies at the middle of the step, (b, 3, 3)."""
    assert model.rigid is not None and params.rigid is not None and state.rigid is not None
    return world_inertia(model.rigid, params.rigid.mass, midway(model.rigid, state.rigid, dt))


def advance_rigid(
    model: Model,
    params: Params,
    state: State,
    velocities: Array,
    dt: Array,
    passed: Array | None = None,
    spin: Array | None = None,
) -> Any:
    """Rigid state after a step with velocities (n + 2 b, 3); None without rigid bodies.

    `passed`, `spin`: see `System`."""
    if model.rigid is None or params.rigid is None or state.rigid is None:
        return None
    linear, angular = jnp.split(velocities[model.nodes :], 2)
    return advanced(model.rigid, params.rigid.mass, state.rigid, linear, angular, dt, passed, spin)


def _with_rigid(
    soft: System, model: Any, params: Any, state: Any, dt: Array, at: Configuration, pull: Mapping[str, Array]
) -> System:
    bodies, mass, rigid = model.rigid, params.rigid.mass, state.rigid
    middle, spin = world_inertia(bodies, mass, midway(bodies, rigid, dt)), free_spin(bodies, rigid, dt)
    inertia, turning, pulled = middle, spin, None
    if pulls(model):
        needed, pulled = needed_stiffness(model, pull, middle, dt, at)
        inertia = middle + dt**2 * needed
        turning = contract("bij,bj->bi", inverse_blocks(inertia), contract("bij,bj->bi", middle, spin))
    linear, angular = prescribed_velocities(bodies, params.rigid.motions, rigid, state.time, dt)
    free = bodies.free[:, None] > 0
    targets = jnp.where(free, rigid.velocities + dt * params.gravity, linear), jnp.where(free, turning, angular)
    size = mass[:, None] * (jnp.abs(rigid.velocities) + dt * jnp.abs(params.gravity))
    return soft.replace(
        mass=jnp.concatenate([soft.mass, mass, jnp.zeros_like(mass)]),
        target=jnp.concatenate([soft.target, *targets]),
        spin=spin,
        pulled=pulled,
        prescribed=jnp.concatenate([soft.prescribed, linear, angular]),
        free=jnp.concatenate([soft.free, bodies.free, bodies.free]),
        floor=soft.floor + jax.lax.stop_gradient(16 * jnp.finfo(mass.dtype).eps * jnp.linalg.norm(size)),
        inertia=inertia,
    )


def _held_mass(model: Model, params: Params, inverse: Array, dt: Array, least: float) -> Array:
    """Inverse masses (n,) of nodes that the material around them holds too, by dt^2 times its stiffness."""
    if not model.nodes:
        return inverse
    own = inverse[: model.nodes]
    share = 1 / (1 + dt**2 * own * nodal_stiffness(model, params))
    return inverse.at[: model.nodes].set(own * jnp.maximum(share, least))


def _hardened(
    rows: PointRows, inverse: Inverse, held: Inverse, gaps: Gaps | None, least: Array | None
) -> tuple[PointRows, Array]:
    """Rows with a trace of compliance, so that redundant or conflicting ones have a finite answer; and that trace.

    1e-9 (1e-6 in single precision) of what a unit impulse on a row moves it by, each node as the material around it
    lets it (`held`): a gram of what is stiff may carry tonnes; or `least` (m, r). What a row gives by itself counts
    towards that, so that a spring is as stiff as it was declared. Rows that move nothing get 1.
    Contacts that are deep may pull as well, as much as it takes to stop what moves apart with `gaps.brake`: speed that
    they got from being moved apart is no momentum.
    """
    # A trace is too small for its own derivative to matter; what contacts ask for is not.
    diagonal = jax.lax.stop_gradient(rows.diagonal(*held))
    trace = TRACE[rows.bias.dtype.itemsize > 4] * diagonal
    trace = trace if least is None else jnp.maximum(trace, least)
    lacking = jnp.maximum(trace - jax.lax.stop_gradient(rows.compliance), 0)
    own = jnp.where(diagonal > 0, lacking, 1)
    rows = rows.replace(compliance=rows.compliance + own)
    if gaps is None or gaps.brake is None or rows.lower is None:
        return rows, own
    diagonal = rows.diagonal(*inverse)
    stopping = jnp.where(gaps.brake > 0, gaps.brake / jnp.where(diagonal > 0, diagonal, jnp.inf), 0)
    return rows.replace(lower=rows.lower - stopping), own
