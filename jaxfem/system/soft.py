"""One step as a condition on the end-of-step velocity, the same for every route to its solution."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.elasticity import viscoelastic_force
from jaxfem.elements.mass import MassCoupling
from jaxfem.loads import load_force
from jaxfem.model import Model, Params, Pattern, State, domain_materials, mass_coupling, nodal_mass
from jaxfem.motion import displaced
from jaxfem.pytrees import Pytree, static
from jaxfem.rows.base import Rows, total_impulse
from jaxfem.rows.elastic import ElasticRows, elastic_rows
from jaxfem.rows.points import PointRows
from jaxfem.schemes import Stage, alpha_stage, backward_euler_stage, moved_to
from jaxfem.system.memory import step_materials
from jaxfem.tensors import inverse_blocks

Array = jax.Array


class Friction(Pytree):
    """Rows `tangent` (m, 2) are bounded by `coefficient` (m,) times the impulses of rows `normal` (m, 1)."""

    coefficient: Array
    normal: int = static()
    tangent: int = static()


class System(Pytree):
    """One step, prepared: rows at the start-of-step configuration and everything else a route needs.

    `rows`: tuple of kinds, elastic first. `mass` (n,) [kg]; `target` v* (n, 3) and `prescribed` (n, 3) [m/s];
    `free` (n,) 1 or 0; `floor` [N s]: residual below which only rounding is left; `positions` (n, 3) at the start of
    the step; `coarse`: the preconditioner's inverse, built at some earlier shape (see `condensed.py`). `coupling`:
    what the masses have that is not lumped; it acts on the change from the velocities `before` (n, 3).
    With rigid bodies n counts all triples (see `rows/attachments.py`), `inertia` (b, 3, 3) are the blocks of the last b
    of them, whose `mass` is 0, and `friction` says which rows bound which (see `coupled.py`).
    `elimination`: the order in which rows are eliminated, None where they are not (see `row_order.py`). `impact`
    (n,): where something strikes within a step of the second-order scheme, which there is one of backward Euler.
    """

    rows: tuple[Rows, ...]
    mass: Array
    target: Array
    prescribed: Array
    free: Array
    floor: Array
    pattern: Pattern
    tolerance: Array
    max_iterations: Array
    positions: Array
    coarse: Any
    coupling: MassCoupling | None = None
    before: Array | None = None
    inertia: Array | None = None
    friction: tuple[Friction, ...] = ()
    elimination: Any = None
    impact: Array | None = None


def step_system(
    model: Model,
    params: Params,
    state: State,
    dt: Array,
    forces: Array | None = None,
    coarse: Array | None = None,
    around: Array | None = None,
    impact: Array | None = None,
) -> System:
    """Prepare a step from `state`; differentiable. `forces` (n, 3) [N]: extra nodal forces, or None.

    `coarse` may be None for those who do not solve. `around` (n, 3): end-of-step velocities of free nodes; rows and
    loads are made where they lead, instead of where the step starts. `impact`: see `System`.
    """
    mass = nodal_mass(model, params.density)
    prescribed = prescribed_velocity(model, params, state, dt)
    free = model.free[:, None] > 0
    stage = stage_of(model, state, prescribed, dt, impact)
    stage = stage if around is None else moved_to(stage, jnp.where(free, around, prescribed))
    load = stage.weight * external_force(model, params, stage.base, forces)
    return System(
        rows=elastic_rows(model.domains, stage, step_materials(model, params, state, dt), model.rotation),
        mass=mass,
        target=jnp.where(free, stage.start + load / mass[:, None], prescribed),
        prescribed=prescribed,
        free=model.free,
        floor=_rounding_floor(mass, load, state.velocities),
        pattern=model.pattern,
        tolerance=model.tolerance,
        max_iterations=model.max_iterations,
        positions=jax.lax.stop_gradient(stage.base),
        coarse=coarse,
        coupling=mass_coupling(model, params.density),
        before=None if model.mass == "lumped" else jnp.where(free, stage.start, state.velocities),
        impact=impact,
    )


def extra_rows(system: System) -> tuple[PointRows, ...]:
    """The rows that are not elastic: contacts, limits, motors, joints."""
    return tuple(rows for rows in system.rows if isinstance(rows, PointRows))


def elastic_part(system: System) -> System:
    """The same step without its extra rows."""
    rows = tuple(each for each in system.rows if isinstance(each, ElasticRows))
    return system.replace(rows=rows)


def merged(system: System, unknown: Array) -> Array:
    """Velocities of all nodes from the unknown on the free ones, (n, 3)."""
    return jnp.where(system.free[:, None] > 0, unknown, system.prescribed)


def inverse_mass(system: System) -> tuple[Array, Array | None]:
    """Inverse masses (n,), zero on what does not move and on angular triples, and angular blocks (b, 3, 3) or None."""
    scalar = jnp.where(system.mass > 0, system.free / jnp.where(system.mass > 0, system.mass, 1), 0)
    if system.inertia is None:
        return scalar, None
    bodies = system.inertia.shape[0]
    return scalar, inverse_blocks(system.inertia) * system.free[-bodies:, None, None]


def momentum_gradient(system: System, unknown: Array) -> Array:
    """Gradient of the primal objective, (n, 3) [N s]: M (v - v*) - J' clip((c - J v) / C, lower, upper).

    Fixed triples carry M times the unknown, so that the Hessian stays symmetric positive definite and they solve to 0.
    """
    velocities = merged(system, unknown)
    mass = system.mass[:, None]
    residual = mass * (velocities - system.target) - total_impulse(system.rows, velocities)
    own = mass * unknown
    if system.coupling is not None and system.before is not None:
        residual = residual + system.coupling.apply(velocities - system.before)
    if system.inertia is not None:
        change = jnp.stack([velocities - system.target, unknown])[:, -system.inertia.shape[0] :]
        spin = jnp.einsum("bij,sbj->sbi", system.inertia, change)
        angular = slice(-system.inertia.shape[0], None)
        residual, own = residual.at[angular].add(spin[0]), own.at[angular].add(spin[1])
    return jnp.where(system.free[:, None] > 0, residual, own)


def external_force(model: Model, params: Params, positions: Array, forces: Array | None = None) -> Array:
    """Gravity, declared loads and extra nodal forces, (n, 3) [N]."""
    weight = nodal_mass(model, params.density)[:, None] * params.gravity
    total = weight + load_force(model.loads, params.loads, positions)
    return total if forces is None else total + forces


def elastic_rounding(model: Model, params: Params, positions: Array) -> Array:
    """Force [N] that the rounding of positions alone makes: its change when they change by half their last digit.

    Each by that of the largest, up or down by chance. Bounds from the stiffness are far off near nu = 0.5, where one
    node's volume may be stiff and the mean over many is what is felt.
    """
    signs = jax.random.rademacher(jax.random.key(0), positions.shape, positions.dtype)
    digit = 0.5 * jnp.finfo(positions.dtype).eps * jnp.max(jnp.abs(positions))
    materials, still = domain_materials(model, params), jnp.zeros_like(positions)

    def force(x: Array) -> Array:
        return viscoelastic_force(model.domains, x, still, materials, model.rotation)

    return jnp.linalg.norm(force(positions + digit * signs) - force(positions))


def prescribed_velocity(model: Model, params: Params, state: State, dt: Array) -> Array:
    """Velocities (n, 3) that bring driven nodes to their place at the end of the step; zero on all others."""
    velocity = jnp.zeros_like(model.rest)
    for nodes, motion in zip(model.driven, params.motions, strict=True):
        # To the place itself, not along the path's increments: those would let rounding add up.
        place = displaced(motion, model.rest[nodes], state.time + dt)
        velocity = velocity.at[nodes].set((place - state.positions[nodes]) / dt)
    return velocity


def stage_of(model: Model, state: State, prescribed: Array, dt: Array, impact: Array | None = None) -> Stage:
    """Where the scheme makes a step's rows; `prescribed` (n, 3): velocities of driven nodes."""
    x, v = state.positions, state.velocities
    plain = backward_euler_stage(x, v, dt)
    if model.scheme == "backward_euler":
        return plain
    accelerations = jnp.zeros_like(v) if state.accelerations is None else state.accelerations
    stage = alpha_stage(x, v, accelerations, prescribed, model.free[:, None] > 0, dt, model.rho_inf)
    if impact is None:
        return stage
    plain = plain.replace(ahead=jnp.zeros_like(v), before=jnp.zeros_like(v))
    return jax.tree.map(lambda one, other: jnp.where(impact[:, None], one, other), plain, stage)  # type: ignore[no-any-return]


def _rounding_floor(mass: Array, load: Array, velocities: Array) -> Array:
    """At rest forces cancel, and a residual relative to their sum would mean nothing: this bounds it from below."""
    size = jnp.linalg.norm(load) + jnp.linalg.norm(mass[:, None] * velocities)
    return jax.lax.stop_gradient(16 * jnp.finfo(mass.dtype).eps * size)
