"""The start of a run: the accelerations that some schemes carry, where they are not known yet."""

from typing import Any

import jax

from jaxfem.elements.elasticity import viscoelastic_force
from jaxfem.model import Model, Params, State, nodal_mass, shared_mass
from jaxfem.solvers.implicit import or_nan
from jaxfem.solvers.pcg import pcg
from jaxfem.system.drag import nodal_drag
from jaxfem.system.memory import soon, step_materials
from jaxfem.system.soft import external_force

Array = jax.Array


def begun(model: Model, params: Params, state: State, forces: Array | None) -> State:
    """The state with the accelerations that its forces give, where the scheme needs them and they are not known."""

    def acceleration() -> Array:
        force = external_force(model, params, state.positions, forces)
        materials = step_materials(model, params, state, soon(model.rest.dtype))
        force = force + viscoelastic_force(
            model.domains, state.positions, state.velocities, materials, model.rotation_kind
        )
        found = _acceleration(model, params, force)
        if not model.dragged:
            return found
        return found - (nodal_drag(model, params) * model.free)[:, None] * state.velocities  # C = alpha M

    return state.replace(accelerations=model.scheme.begin(state, acceleration))


def _acceleration(model: Model, params: Params, force: Array) -> Array:
    """M^-1 times a force (n, 3) [N] on the free nodes, zero on the others."""
    mass, free = nodal_mass(model, params.density)[:, None], model.free[:, None]
    shared = shared_mass(model, params.density)
    if shared is None:
        return force / mass * free

    def product(vector: Array) -> Array:
        return mass * vector + free * shared.apply(free * vector)

    def solve(matvec: Any, right: Array) -> Array:
        return or_nan(*pcg(matvec, right, lambda r: r / jax.lax.stop_gradient(mass), tol=model.tolerance))

    found: Array = jax.lax.custom_linear_solve(product, force * free, solve, symmetric=True)
    return found
