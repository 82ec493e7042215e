"""The end of a step, the same for all methods: velocities become positions, and the step's info is put together."""

import jax
import jax.numpy as jnp

from jaxfem.elements.tetra import deformation_gradient
from jaxfem.methods.base import Solved
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.schemes import BackwardEuler, scheme_damping
from jaxfem.system.account import booked
from jaxfem.system.carry import carried, increments_only
from jaxfem.system.coupled import advance_rigid
from jaxfem.system.memory import committed
from jaxfem.system.momentum import spin_loss
from jaxfem.tensors import determinant

Array = jax.Array


def ended(
    model: Model,
    params: Params,
    state: State,
    dt: Array,
    solved: Solved,
    impact: Array | None = None,
    passed: Array | None = None,
    forces: Array | None = None,
    spin: Array | None = None,
) -> tuple[State, StepInfo]:
    """The next state and the step's info. `impact` (n,): nodes whose step is one of backward Euler; None: no such.

    `passed` (b,), `spin` (b, 3): see `System`. `forces` (n, 3) [N]: those that `step` was given.
    """
    velocities = solved.velocities[: model.nodes]
    start = state if state.carry is None else increments_only(state)
    positions, accelerations = _moved(model, start, velocities, dt, impact)
    following = state.replace(
        positions=positions,
        velocities=velocities,
        time=state.time + dt,
        memory=solved.impulses,
        accelerations=accelerations,
        rigid=advance_rigid(model, params, start, solved.velocities, dt, passed, spin),
    )
    if state.carry is not None:
        following = carried(state, following, dt)
    positions = following.positions
    internal, counts = committed(model, params, state, positions, dt)
    following = following.replace(internal=internal)
    if state.account is not None:
        following = following.replace(account=booked(model, params, state, following, dt, forces))
    info = solved.info
    return following, StepInfo(
        info.status,
        info.iterations,
        info.residual,
        info.weakly_active,
        inverted_elements(model, positions),
        _scheme_damping(model, dt, impact),
        spin_loss=None if model.drifting is None else spin_loss(model, params, state, following, dt, forces),
        counts=counts,
    )


def inverted_elements(model: Model, positions: Array) -> Array:
    """Number of elements turned inside out at `positions` (n, 3)."""
    return jnp.sum(determinant(deformation_gradient(model.elements, positions)) <= 0)


def _moved(
    model: Model, state: State, velocities: Array, dt: Array, impact: Array | None
) -> tuple[Array, Array | None]:
    """Positions and accelerations at the end of a step with `velocities`; after an `impact` the latter are zero."""
    free = model.free[:, None] > 0
    positions, accelerations = model.scheme.advance(state, velocities, free, dt)
    if impact is None:
        return positions, accelerations
    plain, _ = BackwardEuler().advance(state, velocities, free, dt)
    positions = jnp.where(impact[:, None], plain, positions)
    return positions, None if accelerations is None else jnp.where(impact[:, None], 0, accelerations)


def _scheme_damping(model: Model, dt: Array, impact: Array | None) -> Array | None:
    """Damping ratio that the step gives to the model's `frequencies`; backward Euler's where something struck."""
    if model.frequencies is None:
        return None
    own = scheme_damping(model.scheme, model.frequencies, dt)
    if impact is None:
        return own
    return jnp.where(jnp.any(impact), scheme_damping(BackwardEuler(), model.frequencies, dt), own)
