"""A step with lanes last, and runs of them: every scheme, driven nodes, loads, materials by region, lanes that stop.

With a stage of the scheme (see `schemes/base.py`) and beta the damping, strain is taken at x + reach v with the rate
before + follow v, so the increment of velocity solves
    (M + weight (reach + beta follow) K) dv = M (start - v) + weight (f_ext - f(x_a) - beta K v_a),  all at the last v.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.loads import load_force
from jaxfem.model import Model, Params, State, element_constants, nodal_mass, per_element
from jaxfem.pytrees import Pytree
from jaxfem.solvers.status import Status
from jaxfem.stepping.begin import begun
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.kernels import determinant, pairing, rotation, strain_force, turned_gradients
from jaxfem.sweeping.lanes.solve import modal, solve
from jaxfem.system.carry import _sum
from jaxfem.system.soft import prescribed_velocity

Array = jax.Array


class Lane(Pytree):
    """What of a variant does not change in a run: `lam`, `mu`, `beta` (E + 1, lanes) or (1, lanes), `mass`
    (n, 1, lanes), `weight` (n, 3, lanes) [N], and relative to the body's modes the mean `stiffness` and `density`
    (lanes,), with the mean `damping` [s].
    """

    lam: Array
    mu: Array
    beta: Array
    mass: Array
    weight: Array
    stiffness: Array
    density: Array
    damping: Array


class Moving(Pytree):
    """A run on its way, lanes last, nodes in the body's order: see `State`; `dropped`: digits of positions, or None.
    `failed`: the status at which a lane has stopped, 0 while it goes on."""

    positions: Array
    velocities: Array
    accelerations: Array | None
    dropped: Array | None
    time: Array
    lost: Array
    failed: Array


class Told(Pytree):
    """Of a step: see `StepInfo`, (lanes,) each."""

    status: Array
    iterations: Array
    residual: Array
    inverted: Array


def lane_of(model: Model, body: Body, params: Params) -> Lane:
    """The numbers of one variant, without the axis of lanes."""
    values = element_constants(model, params)
    stiff = model.laws[0].stiffness(values)
    volumetric, deviatoric = (jnp.atleast_1d(v) for v in stiff)
    beta = jnp.atleast_1d(values["damping"])
    share = model.elements.volumes / model.elements.volumes.sum()

    def mean(value: Array) -> Array:
        return value[0] if value.shape == (1,) else (share * value).sum()

    def filled(value: Array) -> Array:
        return value if value.shape == (1,) else jnp.concatenate([value, value[:1]])

    mass = nodal_mass(model, params.density)[body.order][:, None]
    return Lane(
        lam=filled((volumetric - deviatoric) / 3),
        mu=filled(deviatoric / 2),
        beta=filled(beta),
        mass=mass,
        weight=mass * params.gravity,
        stiffness=mean(deviatoric) / body.stiffness,
        density=mean(per_element(model, params.density)) / body.density,
        damping=mean(beta),
    )


def first(model: Model, body: Body, params: Params, state: State, failed: Array) -> Moving:
    """Where one variant starts, without the axis of lanes."""
    state = begun(model, params, state, None)
    carry = state.carry
    return Moving(
        state.positions[body.order],
        state.velocities[body.order],
        None if state.accelerations is None else state.accelerations[body.order],
        None if carry is None else carry.nodes[body.order],
        state.time,
        jnp.zeros_like(state.time) if carry is None else carry.time,
        failed,
    )


def step(model: Model, body: Body, lane: Lane, params: Params, at: Moving, dt: Array) -> tuple[Moving, Told]:
    """One step of all lanes; `params`: leaves with lanes last; `dt` (lanes,)."""
    free = jnp.arange(at.positions.shape[0])[:, None, None] < body.free
    prescribed = _prescribed(model, body, params, at, dt)
    stage = model.scheme.stage(at, prescribed, free, dt)
    r, inverted = rotation(body, pairing(body, stage.base, body.gradients) + body.nothing)
    turned = turned_gradients(body, r)
    load = stage.weight * _external(model, body, lane, params, stage.base)
    v = jnp.where(free, at.velocities, prescribed)
    nf, b = body.free, _right(body, lane, stage, turned, v, load)[: body.free]
    still = jnp.zeros((at.positions.shape[0] - nf, *b.shape[1:]), b.dtype)
    reach = stage.reach + lane.beta * stage.follow
    lam, mu = (stage.weight * reach * each for each in (lane.lam, lane.mu))

    def matrix(p: Array) -> Array:
        gradient = pairing(body, jnp.concatenate([p, still]), turned)
        return lane.mass[:nf] * p + strain_force(body, turned, gradient, lam, mu)[:nf]

    def norm(a: Array) -> Array:
        return jnp.sqrt((a * a).sum((0, 1)))

    floor = 16 * jnp.finfo(b.dtype).eps * (norm(load) + norm(lane.mass * at.velocities))
    target = jnp.maximum(model.tolerance * norm(b), floor)
    scale = stage.weight * (stage.reach + lane.damping * stage.follow) * lane.stiffness * body.stiffness / body.density
    found = solve(matrix, modal(body, r, scale, lane.density), b, target, at.failed == 0, model.max_iterations)
    return _ended(model, body, at, dt, free, v.at[:nf].add(found.solution), found, inverted)


def _right(body: Body, lane: Lane, stage: Any, turned: Array, v: Array, load: Array) -> Array:
    """The momentum that is left to do at the velocities v, (n, 3, lanes)."""
    place = stage.base + stage.reach * v if stage.ahead is None else stage.base + stage.ahead + stage.reach * v
    rate = stage.follow * v if stage.before is None else stage.before + stage.follow * v
    if lane.beta.shape[0] == 1:  # one damping for all elements: both in one pass
        whole = pairing(body, body.fence(lambda: place + lane.beta * rate), turned)
    else:
        strained, rates = pairing(body, place, turned), pairing(body, rate, turned)
        whole = body.fence(lambda: strained + lane.beta[:, None, None] * rates)
    force = strain_force(body, turned, whole, lane.lam, lane.mu, 1.0)
    left: Array = lane.mass * (stage.start - v) + load - stage.weight * force
    return left


def _ended(
    model: Model, body: Body, at: Moving, dt: Array, free: Array, v: Array, found: Any, inverted: Array
) -> tuple[Moving, Told]:
    """Where the step ends; lanes that failed stay where they were, with what they failed at."""
    origin = at if at.dropped is None else at.replace(positions=jnp.zeros_like(at.positions))
    positions, accelerations = model.scheme.advance(origin, v, free, dt)
    time, lost, dropped = at.time + dt, at.lost, at.dropped
    if dropped is not None:
        positions, dropped = _sum(at.positions, positions, dropped)
        time, lost = _sum(at.time, dt, at.lost)
    finite = found.finite & jnp.isfinite(positions).all((0, 1)) & jnp.isfinite(v).all((0, 1))
    status = jnp.where(finite, jnp.where(found.converged, 0, int(Status.ITERATION_LIMIT)), int(Status.NOT_FINITE))
    going = at.failed == 0
    reached = Moving(positions, v, accelerations, dropped, time, lost, jnp.where(going, status, at.failed))
    kept: Moving = jax.tree.map(lambda new, old: jnp.where(going, new, old), reached, at)
    kept = kept.replace(failed=reached.failed.astype(at.failed.dtype))
    return kept, Told(kept.failed, found.iterations, found.residual, inverted)


def _external(model: Model, body: Body, lane: Lane, params: Params, places: Array) -> Array:
    """Weight and loads, (n, 3, lanes) [N]."""
    if not model.loads:
        return lane.weight

    def one(params: Params, places: Array) -> Array:
        return load_force(model.loads, params.loads, places[body.back])[body.order]

    found: Array = body.fence(lambda: lane.weight + jax.vmap(one, in_axes=-1, out_axes=-1)(params, places))
    return found


def _prescribed(model: Model, body: Body, params: Params, at: Moving, dt: Array) -> Array:
    if not model.driven:
        return jnp.zeros_like(at.positions)

    def one(params: Params, places: Array, time: Array, dt: Array) -> Array:
        state = State(places[body.back], places, time)
        return prescribed_velocity(model, params, state, dt)[body.order]

    return jax.vmap(one, in_axes=-1, out_axes=-1)(params, at.positions, at.time, dt)


def inside_out(body: Body, positions: Array) -> Array:
    """How many elements of each lane are, (lanes,)."""
    return (determinant(body, pairing(body, positions, body.gradients) + body.nothing) <= 0).sum(0, dtype=jnp.int32)
