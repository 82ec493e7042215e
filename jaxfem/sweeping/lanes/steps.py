"""A step with lanes last, and runs of them: every scheme, driven nodes, loads, materials by region, lanes that stop.

With a stage of the scheme (see `schemes/base.py`) and beta the damping, strain is taken at x + reach v with the rate
before + follow v, so the increment of velocity solves
    (M + weight (reach + beta follow) K) dv = M (start - v) + weight (f_ext - f(x_a) - beta K v_a),  all at the last v.
"""

from collections import OrderedDict

import jax
import jax.numpy as jnp

from jaxfem.elements.mass import consistent_share, is_diagonal
from jaxfem.loads import load_force
from jaxfem.model import Model, Params, State, element_damping, element_stiffness, nodal_mass, per_element
from jaxfem.pytrees import Pytree
from jaxfem.schemes import BackwardEuler, Stage
from jaxfem.solvers.status import Status
from jaxfem.stepping.begin import begun
from jaxfem.sweeping.lanes.beside import judged, momentum_kept, system_beside
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.bounded import increment_with_rows
from jaxfem.sweeping.lanes.increments import Effort, Equation, Frames, Lane, increment, inertia
from jaxfem.sweeping.lanes.kernels import determinant, pairing, product, rotation, turned_gradients
from jaxfem.sweeping.lanes.loose import angles, kept
from jaxfem.sweeping.lanes.solve import Outcome, norm
from jaxfem.system.carry import _sum
from jaxfem.system.drag import nodal_drag
from jaxfem.system.rigid_part import turning_status, turns_ahead
from jaxfem.system.soft import System, prescribed_velocity

Array = jax.Array


class Moving(Pytree):
    """A run on its way, lanes last, nodes in the body's order: see `State`; `dropped`: digits of positions, or None.
    `failed`: the status at which a lane has stopped, 0 while it goes on. `impulses`: the last ones of joints and
    contacts, by group (m, r), None without such.
    """

    positions: Array
    velocities: Array
    accelerations: Array | None
    dropped: Array | None
    time: Array
    lost: Array
    failed: Array
    impulses: OrderedDict[str, Array] | None = None


class Told(Pytree):
    """Of a step: see `StepInfo`, (lanes,) each."""

    status: Array
    iterations: Array
    residual: Array
    inverted: Array


def lane_of(model: Model, body: Body, params: Params) -> Lane:
    """The numbers of one variant, without the axis of lanes."""
    numbers = *element_stiffness(model, params), element_damping(model, params)
    volumetric, deviatoric, beta = (jnp.atleast_1d(jnp.asarray(v, model.rest.dtype)) for v in numbers)
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
        drag=nodal_drag(model, params)[body.order][:, None] if model.dragged else None,
        shared=None if is_diagonal(model.mass) else _shared(model, params),
    )


def _shared(model: Model, params: Params) -> Array:
    share = consistent_share(model.mass) / 20 * per_element(model, params.density) * model.elements.volumes
    return jnp.append(share, jnp.zeros_like(share[:1]))


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
        state.memory if model.coupled else None,
    )


def step(model: Model, body: Body, lane: Lane, params: Params, at: Moving, dt: Array) -> tuple[Moving, Told]:
    """One step of all lanes; `params`: leaves with lanes last; `dt` (lanes,)."""
    free = jnp.arange(at.positions.shape[0])[:, None, None] < body.free_count
    prescribed = _prescribed(model, body, params, at, dt)
    beside = system_beside(model, body, params, at, dt) if model.coupled else None
    impact = None if beside is None or beside.impact is None else beside.impact[body.order]
    stage = _stage(model, at, prescribed, free, dt, impact)
    base = jax.lax.stop_gradient(stage.base)  # what turns with it is in the force's own derivative
    r, inverted = rotation(body, pairing(body, base, body.gradients) + body.nothing)
    load = stage.weight * _external(model, body, lane, params, stage.base)
    v = jnp.where(free, at.velocities, prescribed)
    floor = 16 * jnp.finfo(v.dtype).eps * (norm(load) + norm(lane.mass * at.velocities))
    effort = Effort(model.tolerance, jax.lax.stop_gradient(floor), model.max_iterations, at.failed == 0)
    angle = None if body.loose is None else angles(body.loose, lane.mass, at.positions, at.velocities, dt)
    ahead = turns_ahead(angle) if angle is not None and model.scheme.straight else None
    known = None if lane.shared is None else jnp.where(free, stage.start, at.velocities)
    equation = Equation(stage, lane, load, v, ahead, known)
    v, impulses, outcome = _solved(model, body, _frames(body, r, ahead), equation, at, beside, effort)
    ended, now = _ended(model, body, at, dt, free, v, impulses, outcome, inverted, impact)
    # As elsewhere, a step that turned too far or gave way is taken, and has the status.
    status = now.status if beside is None else judged(model, body, params, beside, at, ended, dt, now.status)
    status = status if angle is None else turning_status(model.bodies, model.scheme.straight, angle, status)
    status = jnp.where(at.failed == 0, status, now.status)
    return ended.replace(failed=status), now.replace(status=status)


def _stage(model: Model, at: Moving, prescribed: Array, free: Array, dt: Array, impact: Array | None) -> Stage:
    """The scheme's stage; that of backward Euler on nodes where there is an `impact` (n, lanes)."""
    stage = model.scheme.stage(at, prescribed, free, dt)
    if impact is not None:
        stage = BackwardEuler().stage(at, prescribed, free, dt).where(impact, stage)
    found: Stage = stage.replace(follow=jnp.asarray(stage.follow, dt.dtype))
    return found


def _solved(
    model: Model, body: Body, frames: Frames, equation: Equation, at: Moving, beside: System | None, effort: Effort
) -> tuple[Array, OrderedDict[str, Array] | None, Outcome]:
    """Velocities (n, 3, lanes) at the end of the step, impulses of joints and contacts, and how the solve went."""
    v, impulses = equation.velocities, at.impulses
    if beside is None or impulses is None:
        change, outcome = increment(body, frames, equation, effort)
    else:
        change, impulses, outcome = increment_with_rows(body, frames, equation, beside, impulses, effort)
    v = jnp.concatenate([v[: body.free_count] + change, v[body.free_count :]])
    return _with_momentum(model, body, equation, at, v, beside, impulses), impulses, outcome


def _with_momentum(
    model: Model,
    body: Body,
    equation: Equation,
    at: Moving,
    v: Array,
    beside: System | None,
    impulses: OrderedDict[str, Array] | None,
) -> Array:
    """Velocities (n, 3, lanes) with the momentum that free bodies keep."""
    if beside is not None and impulses is not None:
        return momentum_kept(model, body, beside, at.positions, v, impulses)
    if body.loose is None:
        return v
    stage, lane, mass = equation.stage, equation.lane, inertia(equation.stage, equation.lane)
    defect = lane.mass * (v - stage.start) - equation.load
    if lane.drag is not None:
        known = 0.0 if stage.before is None else stage.before
        defect = defect + stage.weight * lane.mass * lane.drag * (known + stage.follow * v)
    return kept(body.loose, mass, at.positions, v, defect, model.scheme.straight)


def _frames(body: Body, r: Array, ahead: Array | None) -> Frames:
    """The rotations of a step from those `r` of its start."""
    if ahead is None or body.loose is None:
        return Frames(r, turned_gradients(body, r), None)
    held = jax.lax.stop_gradient(ahead)
    r = product(body, body.loose.of_elements(held), r)
    return Frames(r, turned_gradients(body, r), held)


def _ended(
    model: Model,
    body: Body,
    at: Moving,
    dt: Array,
    free: Array,
    v: Array,
    impulses: OrderedDict[str, Array] | None,
    found: Outcome,
    inverted: Array,
    impact: Array | None,
) -> tuple[Moving, Told]:
    """Where the step ends; lanes that failed stay where they were, with what they failed at."""
    origin = at if at.dropped is None else at.replace(positions=jnp.zeros_like(at.positions))
    positions, accelerations = model.scheme.advance(origin, v, free, dt)
    if impact is not None:
        struck = impact[:, None]
        positions = jnp.where(struck, BackwardEuler().advance(origin, v, free, dt)[0], positions)
        accelerations = None if accelerations is None else jnp.where(struck, 0, accelerations)
    time, lost, dropped = at.time + dt, at.lost, at.dropped
    if dropped is not None:
        positions, dropped = _sum(at.positions, positions, dropped)
        time, lost = _sum(at.time, dt, at.lost)
    finite = found.finite & jnp.isfinite(positions).all((0, 1)) & jnp.isfinite(v).all((0, 1))
    status = jnp.where(finite, jnp.where(found.converged, 0, int(Status.ITERATION_LIMIT)), int(Status.NOT_FINITE))
    going = at.failed == 0
    status = jnp.where(going, status, at.failed)
    reached = Moving(positions, v, accelerations, dropped, time, lost, status, impulses)
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
    positions = jax.lax.stop_gradient(positions)
    return (determinant(body, pairing(body, positions, body.gradients) + body.nothing) <= 0).sum(0, dtype=jnp.int32)
