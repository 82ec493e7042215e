"""Energies of a state, for plots, checks and the static solver."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import one_program
from jaxfem.elements.elasticity import elastic_energy
from jaxfem.model import Model, Params, State, nodal_mass, shared_mass
from jaxfem.pytrees import Pytree
from jaxfem.rigid.dynamics import rigid_energies
from jaxfem.system.account import first_account
from jaxfem.system.memory import beside_strain, resting_materials
from jaxfem.system.own_elasticity import own_elasticity
from jaxfem.tensors import inner

Array = jax.Array


class Energies(Pytree):
    """`kinetic`, `elastic` (all that is stored) and `gravity` (potential, zero at the undeformed place) [J].

    `booked`: what left the soft bodies since an account is kept (see `with_account`), by kind: "damping", "viscous" and
    "plastic" losses, minus the work of "loads" and of "supports" that are driven; None without. The sum of all is
    constant to the time scheme's order but for what contacts, joints and rigid bodies do.
    """

    kinetic: Array
    elastic: Array
    gravity: Array
    booked: dict[str, Array] | None = None

    @property
    def kinds(self) -> dict[str, Array]:
        """All of them by name."""
        return {"kinetic": self.kinetic, "elastic": self.elastic, "gravity": self.gravity, **(self.booked or {})}


@one_program
def energies(model: Model, params: Params, state: State) -> Energies:
    """Energies of a state [J], rigid bodies counted in."""
    mass = nodal_mass(model, params.density)
    weight = mass[:, None] * params.gravity
    shared = shared_mass(model, params.density)
    momentum = mass[:, None] * state.velocities
    momentum = momentum if shared is None else momentum + shared.apply(state.velocities)
    kinetic = gravity = jnp.zeros((), state.positions.dtype)
    if model.rigid is not None and state.rigid is not None:
        kinetic, gravity = rigid_energies(model.rigid, params.rigid, params.gravity, state.rigid)
    return Energies(
        kinetic=kinetic + 0.5 * inner(state.velocities, momentum),
        elastic=total_elastic_energy(model, params, state.positions, state.internal),
        gravity=gravity - jnp.sum(weight * (state.positions - model.rest)),
        booked=state.account,
    )


def with_account(model: Model, params: Params, state: State) -> State:
    """The state with an empty account of energy: steps then book what is lost, and the work of loads and drives.

    `energies` then tells it. It costs each step two more strains; states without an account pay nothing.
    """
    return state.replace(account=first_account(model, params, state))


def total_elastic_energy(model: Model, params: Params, positions: Array, internal: Any = None) -> Array:
    """Elastic energy of all bodies at `positions` (n, 3) [J]; `internal`: what their materials remember."""
    own = own_elasticity(model, params, positions, jnp.zeros_like(positions))
    if own is not None:
        return jnp.asarray(own.energy, positions.dtype)
    materials = resting_materials(model, params, internal)
    energy = elastic_energy(model.domains, positions, materials, model.rotation_kind)
    return energy if internal is None else energy + beside_strain(model, params, internal)
