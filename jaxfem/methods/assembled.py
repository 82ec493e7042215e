"""M u'' + D u' + K u = f with stiffness matrices warped element by element (Mueller & Gross 2004), assembled.

Element stiffness K_e is that of the rest shape, turned along with the element: its force is R K_e (R' x - X). With
D = alpha M + beta K and implicit Euler, x1 = x0 + dt v, a step is
    ((1 + dt alpha) M + dt (dt + beta) K) v = M v0 + dt (f - sum R K_e (R' x0 - X)),
K the sum of R K_e R' with the rotations of the start of the step. Rows eliminated onto the nodes ("condensed") are the
same step, found on the other way: row by row from strains.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.elements.tetra import Elements, deformation_gradient, rotation_of
from jaxfem.methods.base import Facts, Method, Solved
from jaxfem.methods.ending import ended
from jaxfem.methods.node_blocks import (
    NodeCondition,
    NodePairs,
    NodeSystem,
    check_linear,
    node_pairs,
    refuses_but_plain,
    rounding_floor,
)
from jaxfem.model import Model, Params, State, StepInfo, element_damping, element_stiffness, nodal_mass
from jaxfem.solvers.implicit import implicit_solution
from jaxfem.system.drag import nodal_drag
from jaxfem.system.soft import external_force, prescribed_velocity
from jaxfem.tensors import EXACT, array_of

Array = jax.Array


class Assembled(Method):
    """The assembled system, solved by conjugate gradients with the nodes' own blocks as preconditioner."""

    name: ClassVar[str] = "assembled"

    def refuses(self, facts: Facts) -> str | None:
        """All but plain tetrahedra with lumped masses under backward Euler, nothing tied to them."""
        return refuses_but_plain(facts)

    def plan(self, model: Model, params: Params, state: State) -> NodePairs:
        """The pairs of nodes that share an element."""
        check_linear(model)
        return node_pairs(np.asarray(model.elements.cells, np.int64), model.nodes)

    def step(
        self, model: Model, params: Params, state: State, dt: Array, forces: Array | None, cache: Any
    ) -> tuple[State, StepInfo]:
        """Assemble, solve, move."""
        system = assembled_system(model, params, state, dt, forces)
        unknown, info = implicit_solution(NodeCondition(), system, state.velocities)
        return ended(model, params, state, dt, Solved(system.merged(unknown), None, info), forces=forces)


def assembled_system(model: Model, params: Params, state: State, dt: Array, forces: Array | None) -> NodeSystem:
    """The step at the head of this file."""
    x, pairs = state.positions, model.plan
    turned = jnp.moveaxis(array_of(rotation_of(deformation_gradient(model.elements, x), model.rotation_kind)), -1, 0)
    stiffness = warped_stiffness(model, params, turned)
    mass = nodal_mass(model, params.density)
    load = dt * (external_force(model, params, x, forces) - warped_force(model, stiffness, turned, x))
    beta = jnp.broadcast_to(element_damping(model, params), model.elements.volumes.shape)
    matrix = pairs.summed((dt * (dt + beta))[:, None, None, None, None] * stiffness)
    inertia = mass * (1 + dt * nodal_drag(model, params))
    matrix = matrix.at[:, :, :3].add(inertia[:, None, None] * jnp.eye(3, dtype=mass.dtype))
    return NodeSystem(
        pairs=pairs,
        matrix=matrix,
        right=mass[:, None] * state.velocities + load,
        free=model.free[:, None] > 0,
        prescribed=prescribed_velocity(model, params, state, dt),
        scale=mass,
        floor=rounding_floor(mass, load, state.velocities),
        tolerance=model.tolerance,
        max_iterations=model.max_iterations,
    )


def stiffness_blocks(elements: Elements, gradients: Array, lam: Array, shear: Array) -> Array:
    """Blocks V (lambda g_a g_b' + mu g_b g_a' + mu g_a.g_b I), (E, 4, 4, 3, 3) [N/m]; `gradients` (E, 4, 3) [1/m].

    `lam`, `shear`: Lame's constants [Pa], each () or (E,).
    """
    volumes = elements.volumes
    across = gradients[:, :, None, :, None] * gradients[:, None, :, None, :]
    dots = jnp.einsum("eai,ebi->eab", gradients, gradients, precision=EXACT)
    first, second = (jnp.broadcast_to(each, volumes.shape) * volumes for each in (lam, shear))
    unit = jnp.eye(3, dtype=volumes.dtype)
    own = across.swapaxes(-1, -2) + dots[..., None, None] * unit
    return first[:, None, None, None, None] * across + second[:, None, None, None, None] * own


def lame(model: Model, params: Params) -> tuple[Array, Array]:
    """Lame's constants lambda and mu of the elements, each () or (E,) [Pa]."""
    volumetric, deviatoric = element_stiffness(model, params)
    return (volumetric - deviatoric) / 3, deviatoric / 2


def warped_stiffness(model: Model, params: Params, turned: Array) -> Array:
    """R K_e R' of each element, (E, 4, 4, 3, 3), from rotations `turned` (E, 3, 3): K_e of turned gradients."""
    gradients = jnp.einsum("eij,aje->eai", turned, model.elements.gradients, precision=EXACT)
    return stiffness_blocks(model.elements, gradients, *lame(model, params))


def warped_force(model: Model, stiffness: Array, turned: Array, positions: Array) -> Array:
    """Sum over elements of R K_e (R' x - X), (n, 3) [N]: R K_e R' times x - R X, from each element's first corner."""
    cells = model.elements.cells
    here, rest = positions[cells], model.rest[cells]
    way = here - here[:, :1] - jnp.einsum("eij,eaj->eai", turned, rest - rest[:, :1], precision=EXACT)
    forces = jnp.einsum("eabij,ebj->eai", stiffness, way, precision=EXACT)
    return jnp.zeros_like(positions).at[cells].add(forces)
