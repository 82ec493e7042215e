"""Energies of a state, for plots, checks and the static solver."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.elasticity import elastic_energy
from jaxfem.model import Model, Params, State, nodal_mass, shared_mass
from jaxfem.pytrees import Pytree
from jaxfem.rigid.dynamics import rigid_energies
from jaxfem.system.memory import resting_materials

Array = jax.Array


class Energies(Pytree):
    """`kinetic`, `elastic` and `gravity` (potential, zero at the undeformed place) [J]."""

    kinetic: Array
    elastic: Array
    gravity: Array


def energies(model: Model, params: Params, state: State) -> Energies:
    """Energies of a state [J], rigid bodies counted in."""
    mass = nodal_mass(model, params.density)
    weight = mass[:, None] * params.gravity
    coupling = shared_mass(model, params.density)
    momentum = mass[:, None] * state.velocities
    momentum = momentum if coupling is None else momentum + coupling.apply(state.velocities)
    kinetic = gravity = jnp.zeros((), state.positions.dtype)
    if model.rigid is not None and state.rigid is not None:
        kinetic, gravity = rigid_energies(model.rigid, params.rigid, params.gravity, state.rigid)
    return Energies(
        kinetic=kinetic + 0.5 * jnp.vdot(state.velocities, momentum),
        elastic=total_elastic_energy(model, params, state.positions, state.internal),
        gravity=gravity - jnp.sum(weight * (state.positions - model.rest)),
    )


def total_elastic_energy(model: Model, params: Params, positions: Array, internal: Any = None) -> Array:
    """Elastic energy of all bodies at `positions` (n, 3) [J]; `internal`: what their materials remember."""
    materials = resting_materials(model, params, internal)
    return elastic_energy(model.domains, positions, materials, model.rotation)
