"""One step as a condition on the end-of-step velocity, the same for every method."""

import dataclasses
from collections import OrderedDict
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxfem.elements.elasticity import viscoelastic_force
from jaxfem.elements.mass import SharedMass, is_diagonal
from jaxfem.elements.pattern import Pattern
from jaxfem.loads import load_force
from jaxfem.model import Model, Params, State, domain_materials, nodal_mass, shared_mass
from jaxfem.motion import displaced
from jaxfem.pytrees import Pytree
from jaxfem.rows.base import Rows
from jaxfem.rows.bounds import Friction
from jaxfem.rows.elastic import ElasticRows, StepRows, elastic_rows
from jaxfem.rows.lawful import LawRows
from jaxfem.rows.points import PointRows
from jaxfem.schemes import BackwardEuler, Stage
from jaxfem.system.drag import dragged
from jaxfem.system.memory import step_materials
from jaxfem.system.unsolved import unsolved
from jaxfem.tensors import contract, inner, inverse_blocks

Array = jax.Array

ROUNDING = 3.0  # times the forces that rounding makes of positions: what residuals are seen to stay below


class System(Pytree):
    """One step, prepared: rows at the start-of-step configuration and everything else a method needs.

    `elastic`: elastic rows, one entry for each kind of domains; `extra`: all other rows, by the names of their groups:
    joints, then contacts with their friction; `friction`: which of them are bounded by which (see `rows/bounds.py`).
    `mass` (n,) [kg]; `target` v* (n, 3) and `prescribed` (n, 3) [m/s]; `free` (n,) 1 or 0; `floor` [N s]: residual
    below which only rounding is left; `positions` (n, 3) at the start of the step. `shared_mass`: what the masses have
    that is not lumped; it acts on the change from the velocities `before` (n, 3).
    With rigid bodies n counts all triples (see `rows/attachments.py`), and `inertia` (b, 3, 3) are the blocks of the
    last b of them, whose `mass` is 0. `impact` (n,): where something strikes within a step of a scheme that restarts
    there, which is then one of backward Euler. `passed` (b,): share of the step before a rigid body is struck, in which
    it goes on as it did (see `impacts.py`). `spin` (b, 3): along which free bodies turn in the step. `pulled` (b,): how
    hard joints pull on them, as `pull.py` measures it. `trace`: what of
    the compliance of joints' rows is there to make their matrix regular, by group. `noise` [N s]: what the rounding of
    positions makes of the forces of laws that are not linear, None without such.
    """

    elastic: tuple[StepRows, ...]
    mass: Array
    target: Array
    prescribed: Array
    free: Array
    floor: Array
    pattern: Pattern
    tolerance: Array
    max_iterations: Array
    positions: Array
    extra: OrderedDict[str, PointRows] = dataclasses.field(default_factory=OrderedDict)
    friction: dict[str, Friction] = dataclasses.field(default_factory=dict)
    shared_mass: SharedMass | None = None
    before: Array | None = None
    inertia: Array | None = None
    trace: dict[str, Array] = dataclasses.field(default_factory=dict)
    impact: Array | None = None
    passed: Array | None = None
    spin: Array | None = None
    pulled: Array | None = None
    noise: Array | None = None

    @property
    def rows(self) -> OrderedDict[str, Rows]:
        """All rows by the names of their groups, elastic ones first; of linear laws."""
        elastic = [each for each in self.elastic if isinstance(each, ElasticRows)]
        return OrderedDict([*zip(elastic_names(len(elastic)), elastic, strict=True), *self.extra.items()])

    @property
    def nonlinear(self) -> bool:
        """Whether any law is not linear in the step."""
        return not all(each.domains.law.linear for each in self.elastic)


def elastic_names(count: int) -> list[str]:
    """Names of the groups of elastic rows, one for each kind of domains."""
    return [f"elastic {number}" for number in range(1, count + 1)]


@unsolved
def step_system(
    model: Model,
    params: Params,
    state: State,
    dt: Array,
    forces: Array | None = None,
    around: Array | None = None,
    impact: Array | None = None,
    turns: Array | None = None,
) -> System:
    """Prepare a step from `state`; differentiable. `forces` (n, 3) [N]: extra nodal forces, or None.

    `around` (n, 3): end-of-step velocities of free nodes; rows and loads are made where they lead, instead of where the
    step starts. `impact`: see `System`. `turns`: see `elastic_rows`.
    """
    mass = nodal_mass(model, params.density)
    prescribed = prescribed_velocity(model, params, state, dt)
    free = model.free[:, None] > 0
    stage = stage_of(model, state, prescribed, dt, impact)
    stage = stage if around is None else stage.moved_to(jnp.where(free, around, prescribed))
    load = stage.weight * external_force(model, params, stage.base, forces)
    materials = step_materials(model, params, state, dt, stage)
    dropped = None if state.carry is None else state.carry.nodes
    elastic = elastic_rows(model.domains, stage, materials, model.rotation_kind, turns, dropped)
    system = System(
        elastic=elastic,
        mass=mass,
        target=jnp.where(free, stage.start + load / mass[:, None], prescribed),
        prescribed=prescribed,
        free=model.free,
        floor=_rounding_floor(mass, load, state.velocities),
        pattern=model.pattern,
        tolerance=model.tolerance,
        max_iterations=model.max_iterations,
        positions=jax.lax.stop_gradient(stage.base),
        shared_mass=shared_mass(model, params.density),
        before=None if is_diagonal(model.mass) else jnp.where(free, stage.start, state.velocities),
        impact=impact,
        noise=_rounding_noise(elastic, jax.lax.stop_gradient(stage.base)) if model.nonlinear else None,
    )
    if not model.dragged:
        return system
    held = dragged(model, params, stage, system.mass, system.target, system.shared_mass, system.before)
    return system.replace(**held._asdict())


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
    """Gradient of the primal objective of elastic rows, (n, 3) [N s]: M (v - v*) - J' (c - J v) / C.

    Fixed triples carry M times the unknown, so that the Hessian stays symmetric positive definite and they solve to 0.
    """
    velocities = merged(system, unknown)
    impulses = jnp.zeros_like(velocities)
    for rows in system.elastic:
        impulses = impulses + rows.impulse(velocities)
    return _left(system, unknown, velocities, impulses)


def momentum_objective(system: System, unknown: Array) -> tuple[Array, Array]:
    """The primal objective 1/2 (v - v*)' M (v - v*) + sum Phi of elastic rows, () [J], with its gradient (n, 3)."""
    velocities = merged(system, unknown)
    change, impulses = velocities - system.target, jnp.zeros_like(velocities)
    total = 0.5 * jnp.sum(system.mass[:, None] * change**2)
    for rows in system.elastic:
        energy, own = rows.objective_and_impulse(velocities)
        total, impulses = total + energy, impulses + own
    if system.shared_mass is not None and system.before is not None:
        changed = velocities - system.before
        total = total + 0.5 * inner(changed, system.shared_mass.apply(changed))
    if system.inertia is not None:
        spin = change[-system.inertia.shape[0] :]
        total = total + 0.5 * contract("bi,bij,bj->", spin, system.inertia, spin)
    return total, _left(system, unknown, velocities, impulses)


def _left(system: System, unknown: Array, velocities: Array, impulses: Array) -> Array:
    """The momentum that elastic `impulses` (n, 3) leave to do, see `momentum_gradient`."""
    mass = system.mass[:, None]
    residual = mass * (velocities - system.target) - impulses
    own = mass * unknown
    if system.shared_mass is not None and system.before is not None:
        residual = residual + system.shared_mass.apply(velocities - system.before)
    if system.inertia is not None:
        change = jnp.stack([velocities - system.target, unknown])[:, -system.inertia.shape[0] :]
        spin = contract("bij,sbj->sbi", system.inertia, change)
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
        return viscoelastic_force(model.domains, x, still, materials, model.rotation_kind)

    rounding: Array = jnp.linalg.norm(force(positions + digit * signs) - force(positions))
    return rounding


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
    free = model.free[:, None] > 0
    stage = model.scheme.stage(state, prescribed, free, dt)
    return stage if impact is None else BackwardEuler().stage(state, prescribed, free, dt).where(impact, stage)


def _rounding_noise(elastic: Sequence[StepRows], positions: Array) -> Array:
    """Impulse [N s] that is only rounding in laws that are not linear, several times."""
    found = [each.noise(positions) for each in jax.lax.stop_gradient(elastic) if isinstance(each, LawRows)]
    noise: Array = ROUNDING * jnp.linalg.norm(jnp.stack(found))
    return noise


def _rounding_floor(mass: Array, load: Array, velocities: Array) -> Array:
    """At rest forces cancel, and a residual relative to their sum would mean nothing: this bounds it from below."""
    size = jnp.linalg.norm(load) + jnp.linalg.norm(mass[:, None] * velocities)
    floor: Array = jax.lax.stop_gradient(16 * jnp.finfo(mass.dtype).eps * size)
    return floor
