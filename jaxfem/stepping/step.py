"""step and rollout: pure, jitted, differentiable in every float of params and state."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.elements.elasticity import viscoelastic_force
from jaxfem.elements.tetra import deformation_gradient
from jaxfem.methods.allrows.search import solve_rows
from jaxfem.methods.nodes.condensed import coarse_of
from jaxfem.methods.nonlinear import solve_turning
from jaxfem.methods.solution import solve_system
from jaxfem.model import Model, Params, State, StepInfo, domain_materials, mass_coupling, nodal_mass
from jaxfem.schemes import alpha_advance, scheme_damping
from jaxfem.solvers.implicit import SOLUTION, or_nan
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo
from jaxfem.system.coupled import advance_rigid, coupled_system, velocities_of
from jaxfem.system.memory import committed
from jaxfem.system.soft import System, external_force, step_system
from jaxfem.tensors import determinant

Array = jax.Array


class StepError(ValueError):
    """A call of `step` or `rollout` that cannot be right; the message says what to change."""


def step(model: Model, params: Params, state: State, dt: Any, *, forces: Any = None) -> tuple[State, StepInfo]:
    """Advance by one time step `dt` [s]: (next state, info).

    `forces` (n, 3) [N]: extra nodal forces, held over the step. Differentiable (jvp, vjp, nested) in params, state, dt
    and forces; vmappable. `info.status` is 0 when the solve converged: see `jaxfem.solvers.describe`.
    Raises StepError for dt <= 0 or wrong shapes. Source: Benevolensky & Voroshilov 2009.
    """
    params, state, dt_, forces = typed(model, params, state, dt, forces)
    check_call(model, params, state, dt, forces)
    return _step(model, params, state, dt_, forces)


@jax.jit
def _step(model: Model, params: Params, state: State, dt: Array, forces: Array | None):
    state = _begun(model, params, state, forces)
    return _advance(model, params, state, dt, forces, _coarse(model, params, state, dt))


def prepare(model: Model, params: Params, state: State, dt: Any, *, frequencies: Any = None) -> Model:
    """The model with the solver's preconditioner built in, for loops of your own over `step` [dt in s].

    Without it each call of `step` builds one (some milliseconds); `rollout` builds one for all its steps. It never
    changes a solution, only how fast it is found: prepare again after changing E, density or dt tenfold.
    `frequencies` [rad/s], such as `jf.modes` finds: the info of each step then holds the damping ratio that the time
    scheme gives to each (`info.scheme_damping`); None keeps those that the model has. StepError for others than numbers
    from 0 up.
    """
    params, state, dt_ = typed(model, params, state, dt)
    check_call(model, params, state, dt)
    if frequencies is not None:
        (known,) = typed(model, _checked_frequencies(frequencies))
        model = model.replace(frequencies=known)
    if model.coupled and model.solver != "condensed":
        return model
    return model.replace(coarse=_prepared(model, params, state, dt_))


def _checked_frequencies(given: Any) -> Any:
    if isinstance(given, jax.core.Tracer):
        return given
    try:
        known = np.asarray(given, float)
    except (TypeError, ValueError):
        raise StepError(f"frequencies are {given!r}; give numbers in rad/s, as modes does") from None
    if not (known >= 0).all():
        raise StepError(f"frequencies are {given}; each must be 0 or more, in rad/s (NaN: a mode that was not found)")
    return given


@jax.jit
def _prepared(model: Model, params: Params, state: State, dt: Array) -> Array:
    return coarse_of(step_system(model, params, _begun(model, params, state, None), dt))


def _coarse(model: Model, params: Params, state: State, dt: Array) -> Array | None:
    if model.coupled and model.solver != "condensed":
        return None
    return coarse_of(step_system(model, params, state, dt)) if model.coarse is None else model.coarse


def _advance(model: Model, params: Params, state: State, dt: Array, forces: Array | None, coarse: Array | None):
    impact = None
    if model.coupled:
        system = coupled_system(model, params, state, dt, forces, coarse)
        impact = system.impact
        unknown, impulses, info = _solved(model, state, system)
    elif model.rotations == "implicit":
        unknown, impulses, info = solve_turning(model, params, state, dt, forces, coarse)
    else:
        system = step_system(model, params, state, dt, forces, coarse)
        unknown, impulses, info = solve_system(system, model.solver, state.velocities, state.impulses)
    velocities = unknown[: model.nodes]
    positions, accelerations = _moved(model, state, velocities, dt, impact)
    following = state.replace(
        positions=positions,
        velocities=velocities,
        time=state.time + dt,
        impulses=impulses,
        accelerations=accelerations,
        rigid=advance_rigid(model, params, state, unknown, dt),
        internal=committed(model, params, state, positions, dt),
    )
    added = _scheme_damping(model, dt, impact)
    inverted = inverted_elements(model, following.positions)
    return following, StepInfo(info.status, info.iterations, info.residual, info.weakly_active, inverted, added)


def _solved(model: Model, state: State, system: System) -> tuple[Array, Any, SolveInfo]:
    """Velocities of all triples, impulses in the state's layout, and info of a step with coupled rows."""
    if model.solver != "condensed":
        unknown, (info, impulses) = solve_rows(system, state.impulses, model.solver)
        return unknown, impulses, info
    elastic = len(model.domains)
    last = None if state.impulses is None else state.impulses[elastic:]
    unknown, impulses, info = solve_system(system, "condensed", velocities_of(state), last)
    return unknown, None if last is None else (*(None,) * elastic, *impulses), info


def _scheme_damping(model: Model, dt: Array, impact: Array | None) -> Array | None:
    """Damping ratio that the step gives to the model's `frequencies`; backward Euler's where something struck."""
    if model.frequencies is None:
        return None
    own = scheme_damping(model.scheme, model.frequencies, dt, model.rho_inf)
    if impact is None:
        return own
    return jnp.where(jnp.any(impact), scheme_damping("backward_euler", model.frequencies, dt), own)


def _moved(
    model: Model, state: State, velocities: Array, dt: Array, impact: Array | None
) -> tuple[Array, Array | None]:
    """Positions and accelerations at the end of a step with `velocities`; after an `impact` the latter are zero."""
    plain = state.positions + dt * velocities
    if model.scheme == "backward_euler" or state.accelerations is None:
        return plain, None
    free = model.free[:, None] > 0
    before = state.positions, state.velocities, state.accelerations
    positions, accelerations = alpha_advance(*before, velocities, free, dt, model.rho_inf)
    if impact is None:
        return positions, accelerations
    return jnp.where(impact[:, None], plain, positions), jnp.where(impact[:, None], 0, accelerations)


def _begun(model: Model, params: Params, state: State, forces: Array | None) -> State:
    """The state with the accelerations that its forces give, where the scheme needs them and they are not known."""
    if model.scheme == "backward_euler":
        return state.replace(accelerations=None)
    if state.accelerations is not None:
        return state
    force = external_force(model, params, state.positions, forces)
    materials = domain_materials(model, params)
    force = force + viscoelastic_force(model.domains, state.positions, state.velocities, materials, model.rotation)
    return state.replace(accelerations=_acceleration(model, params, force))


def _acceleration(model: Model, params: Params, force: Array) -> Array:
    """M^-1 times a force (n, 3) [N] on the free nodes, zero on the others."""
    mass, free = nodal_mass(model, params.density)[:, None], model.free[:, None]
    coupling = mass_coupling(model, params.density)
    if coupling is None:
        return force / mass * free

    def product(vector: Array) -> Array:
        return mass * vector + free * coupling.apply(free * vector)

    def solve(matvec: Any, right: Array) -> Array:
        return or_nan(*pcg(matvec, right, lambda r: r / jax.lax.stop_gradient(mass), tol=model.tolerance))

    return jax.lax.custom_linear_solve(product, force * free, solve, symmetric=True)


def inverted_elements(model: Model, positions: Array) -> Array:
    """Number of elements turned inside out at `positions` (n, 3)."""
    return jnp.sum(determinant(deformation_gradient(model.elements, positions)) <= 0)


def rollout(
    model: Model,
    params: Params,
    state: State,
    dt: Any,
    steps: int,
    *,
    every: int = 1,
    forces: Any = None,
    checkpoint: int | None = None,
) -> tuple[State, StepInfo]:
    """Take `steps` steps of `dt` [s]; returns (states, infos) with a leading axis of the steps // every saved frames.

    Every `every`-th state is saved, and the worst info of the steps since the last. `forces`: (n, 3) constant, or
    (steps, n, 3) [N]. Reverse derivatives of long runs need memory: with `checkpoint` = k (a multiple of `every` that
    divides `steps`) only each step's solution is kept; the rest is recomputed k steps at a time without solving again.
    """
    params, state, dt_, forces = typed(model, params, state, dt, forces)
    varying = forces is not None and forces.ndim == 3
    check_call(model, params, state, dt, forces[0] if varying else forces)
    _check_rollout(steps, every, checkpoint)
    if varying and len(forces) != steps:
        raise StepError(f"forces has {len(forces)} rows for {steps} steps")
    return _rollout(model, params, state, dt_, forces, steps, every, checkpoint)


def typed(model: Model, *values: Any) -> Any:
    """Arrays of the model's dtype from whatever numbers a user put there, so that no two calls differ by type alone.

    A list, or a tuple of plain numbers, is one array.
    """

    if not isinstance(model, Model):
        raise StepError(f"the first argument is a {type(model).__name__}; the order is (model, params, state)")

    def one(leaf: Any) -> bool:
        return isinstance(leaf, list) or (
            isinstance(leaf, tuple) and len(leaf) > 0 and all(isinstance(number, int | float) for number in leaf)
        )

    return jax.tree.map(lambda leaf: jnp.asarray(leaf, model.rest.dtype), values, is_leaf=one)


@partial(jax.jit, static_argnames=("steps", "every", "checkpoint"))
def _rollout(model, params, state, dt, forces, steps, every, checkpoint):
    varying = forces is not None and forces.ndim == 3
    state = _begun(model, params, state, forces[0] if varying else forces)
    # Built once: its frames turn with the body, and it only preconditions.
    coarse = _coarse(model, params, state, dt)

    def one(carry: State, force: Array | None):
        return _advance(model, params, carry, dt, force if varying else forces, coarse)

    def frame(carry: State, force: Array | None):
        following, infos = jax.lax.scan(one, carry, force, length=every)
        return following, (following, worst(infos))

    def block(carry: State, force: Array | None):
        return jax.lax.scan(frame, carry, force, length=(checkpoint or steps) // every)

    per_block = (checkpoint or steps) // every
    blocks = steps // (checkpoint or steps)
    sliced = forces.reshape(blocks, per_block, every, *forces.shape[1:]) if varying else None
    if checkpoint is None:
        return block(state, None if sliced is None else sliced[0])[1]
    # Solutions are small and dear, all else is large and cheap: keep the first, recompute the second.
    keep = jax.checkpoint_policies.save_only_these_names(SOLUTION)
    _, saved = jax.lax.scan(jax.checkpoint(block, policy=keep), state, sliced, length=blocks)
    return jax.tree.map(lambda leaf: leaf.reshape(blocks * per_block, *leaf.shape[2:]), saved)


def worst(infos: StepInfo) -> StepInfo:
    """One info for several: the first status that is not 0, the largest of everything else."""
    first = jnp.argmax(infos.status != 0)
    largest = jax.tree.map(lambda leaf: jnp.max(leaf, axis=0), infos)
    return largest.replace(status=infos.status[first])


def check_call(model: Model, params: Params, state: State, dt: Any, forces: Any = None) -> None:
    """Refuse a time step or shapes that cannot be right; values inside jit are not looked at."""
    if not isinstance(model, Model) or not isinstance(params, Params) or not isinstance(state, State):
        given = ", ".join(type(v).__name__ for v in (model, params, state))
        raise StepError(f"got ({given}); the order is (model, params, state), as build returns them")
    if not isinstance(dt, jax.core.Tracer) and not (jnp.ndim(dt) == 0 and 0 < float(dt) < float("inf")):
        raise StepError(f"dt is {dt}; give a positive time step in seconds, like 1e-2")
    shape = model.rest.shape
    for name, value in (("positions", state.positions), ("velocities", state.velocities), ("forces", forces)):
        if value is not None and jnp.shape(value) != shape:
            raise StepError(f"{name} has shape {jnp.shape(value)}; the model's {shape[0]} nodes need {shape}")
    if (state.internal is None) == model.has_memory:
        raise StepError("state.internal belongs to materials with a memory: use the state that build returned")
    _check_params(model, params)


def _check_params(model: Model, params: Params) -> None:
    elements, bodies = model.elements.count, len(model.bodies)
    if set(params.constants) != set(model.constants):
        held, wanted = sorted(params.constants), sorted(model.constants)
        raise StepError(f"params hold the constants {held}; the scene's materials have {wanted}")
    for name, value in params.constants.items():
        found = jnp.shape(value)
        if found not in ((), (1,), (bodies,), (elements,)):
            raise StepError(
                f"{name} has shape {found}; give one number, one for each of the {bodies} bodies, or one for each of "
                f"the {elements} elements"
            )
    _check_coupled(model, params)
    if jnp.shape(params.gravity) != (3,):
        raise StepError(f"gravity has shape {jnp.shape(params.gravity)}; give three numbers, like (0, 0, -9.81)")
    for name, values, known in (("loads", params.loads, model.loads), ("motions", params.motions, model.driven)):
        if len(values) != len(known):
            raise StepError(f"params.{name} holds {len(values)} values; the scene declares {len(known)}")


def _check_coupled(model: Model, params: Params) -> None:
    if (model.rigid is None) != (params.rigid is None):
        raise StepError(
            "params.rigid and model.rigid belong together: use the params that build returned, with changes"
        )
    if model.rigid is not None and params.rigid is not None:
        found, count = jnp.shape(params.rigid.mass), model.rigid.count
        if found != (count,):
            raise StepError(f"rigid.mass has shape {found}; give one mass for each of the {count} bodies")
    for kind in ("joints", "contacts"):
        given, known = set(getattr(params, kind)), set(getattr(model, kind))
        if given != known:
            raise StepError(f"params.{kind} holds {sorted(given)}; the scene's groups are {sorted(known)}")


def _check_rollout(steps: int, every: int, checkpoint: int | None) -> None:
    if steps < 1 or every < 1 or steps % every:
        raise StepError(f"steps = {steps} must be a positive multiple of every = {every}")
    if checkpoint is not None and (checkpoint < 1 or checkpoint % every or steps % checkpoint):
        raise StepError(f"checkpoint = {checkpoint} must be a multiple of every = {every} and divide steps = {steps}")
