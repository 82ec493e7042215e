"""A step's equations, group by group and for the whole: one rotation a group, by mass-weighted shape matching.

With the group's rotation R, its force R K (R'(x - x_cm) - (X - X_cm)), damping alpha M + beta K and x1 = x0 + dt v, a
group j has, in place of (7) of Wang, Xu & Hasegawa,
    A_j v_j = M_j v0 + dt (f_j - R K_j (R'(x0 - x_cm) - (X - X_cm))) + dt f_c,
    A_j = (1 + dt alpha) M_j + dt (dt + beta) R K_j R'
which is their (7) with x = x0 + dt v and the predicted place of (6) put in. K_j takes no notice of x_cm, whichever way
it is distributed: the matrix M_cm of (9) drops out, as a product K_j M_cm is zero, and A_j is symmetric. In the group's
own frame A_j is constant.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.methods.assembled import lame
from jaxfem.methods.groupwise.plan import Groups
from jaxfem.methods.node_blocks import EXACT, rounding_floor
from jaxfem.model import Model, Params, State, element_constants, nodal_mass, per_element
from jaxfem.pytrees import Pytree
from jaxfem.rotation import nearest_rotation
from jaxfem.system.drag import nodal_drag
from jaxfem.system.soft import external_force, prescribed_velocity

Array = jax.Array


class GroupSystem(Pytree):
    """A step of all groups. `rotation` (G, 3, 3); `inertia` (G, N) [kg]: (1 + dt alpha) times masses of the copies,
    `share` (G, N) of a node's mass; `stiff` (E,): dt (dt + beta) times the volume [m^3 s^2], with `lam` and `shear`
    (E,) [Pa]. `right` (G, N, 3) [N s]; `prescribed` (n, 3) [m/s]; `free` (n, 1)."""

    groups: Groups
    cells: Array
    gradients: Array
    rotation: Array
    inertia: Array
    share: Array
    stiff: Array
    lam: Array
    shear: Array
    right: Array
    prescribed: Array
    free: Array
    floor: Array
    tolerance: Array
    max_iterations: Array

    def pull(self, field: Array, scale: Array, turned: bool = True) -> Array:
        """`scale` (E,) K times a field of copies (G, N, 3)."""
        flat = field.reshape(-1, 3)
        corners = flat[self.groups.slots]
        gradient = jnp.einsum("eai,aje->eij", corners[:, 1:] - corners[:, :1], self.gradients[1:], precision=EXACT)
        own = self.rotation[self.groups.element]
        strain = jnp.einsum("eki,ekj->eij", own, gradient, precision=EXACT)
        forces = self.stress_forces(strain, own, scale)
        return jnp.zeros_like(flat).at[self.groups.slots].add(forces).reshape(field.shape)

    def stress_forces(self, strain: Array, own: Array, scale: Array) -> Array:
        """R S grad N_a times `scale` (E,) at each corner, (E, 4, 3), S the stress of sym(strain) (E, 3, 3)."""
        even = strain + strain.swapaxes(1, 2)
        trace = jnp.trace(strain, axis1=1, axis2=2)
        stress = self.shear[:, None, None] * even
        stress = stress + (self.lam * trace)[:, None, None] * jnp.eye(3, dtype=strain.dtype)
        turned = jnp.einsum("eik,ekj->eij", own, scale[:, None, None] * stress, precision=EXACT)
        others = jnp.einsum("eij,aje->eai", turned, self.gradients[1:], precision=EXACT)
        return jnp.concatenate([-others.sum(1, keepdims=True), others], 1)

    def product(self, field: Array) -> Array:
        """A times a field of copies (G, N, 3)."""
        return self.inertia[:, :, None] * field + self.pull(field, self.stiff)

    def spread(self, field: Array) -> Array:
        """A nodal field (n, 3) on the copies."""
        return field[self.groups.nodes]

    def gathered(self, field: Array) -> Array:
        """Sum of copies (G, N, 3) on the nodes, (n, 3); padding must be zero."""
        return jnp.zeros_like(self.prescribed).at[self.groups.nodes].add(field)

    def merged(self, unknown: Array) -> Array:
        """Velocities of all nodes from the unknown on the free ones."""
        return jnp.where(self.free, unknown, self.prescribed)

    def gradient(self, unknown: Array) -> Array:
        """The residual (n, 3) of nodes whose copies are one."""
        left = self.product(self.spread(self.merged(unknown)) * (self.share > 0)[:, :, None]) - self.right
        mass = self.gathered(jnp.broadcast_to(self.inertia[:, :, None], self.right.shape))
        return jnp.where(self.free, self.gathered(left), mass * unknown)


def group_system(model: Model, params: Params, state: State, dt: Array, forces: Array | None) -> GroupSystem:
    """The equations at the head of this file, made at the start of the step."""
    groups: Groups = model.plan
    elements, x = model.elements, state.positions
    values = element_constants(model, params)
    lam, shear, beta = (jnp.broadcast_to(v, elements.volumes.shape) for v in (*lame(model, params), values["damping"]))
    masses = _group_masses(model, params)
    rotation = shape_matching(masses, x[groups.nodes], model.rest[groups.nodes])
    total = nodal_mass(model, params.density)
    share = masses / total[groups.nodes]
    system = GroupSystem(
        groups=groups,
        cells=elements.cells,
        gradients=elements.gradients,
        rotation=rotation,
        inertia=masses * (1 + dt * nodal_drag(model, params))[groups.nodes],
        share=share,
        stiff=dt * (dt + beta) * elements.volumes,
        lam=lam,
        shear=shear,
        right=jnp.zeros((*groups.nodes.shape, 3), x.dtype),
        prescribed=prescribed_velocity(model, params, state, dt),
        free=model.free[:, None] > 0,
        floor=jnp.zeros((), x.dtype),
        tolerance=model.tolerance,
        max_iterations=model.max_iterations,
    )
    load = dt * external_force(model, params, x, forces)
    own = masses[:, :, None] * state.velocities[groups.nodes] + share[:, :, None] * load[groups.nodes]
    pull = dt * _warped(system, elements.volumes, x, model.rest)
    return system.replace(right=own - pull, floor=rounding_floor(total, load, state.velocities))


def _group_masses(model: Model, params: Params) -> Array:
    """Masses of the copies (G, N) [kg], each of its own group's elements; zero on padding."""
    groups: Groups = model.plan
    quarter = per_element(model, params.density) * model.elements.volumes / 4
    none = jnp.zeros(groups.nodes.size, quarter.dtype)
    return none.at[groups.slots].add(quarter[:, None]).reshape(groups.nodes.shape)


def shape_matching(masses: Array, places: Array, rest: Array) -> Array:
    """Rotation (G, 3, 3) that takes each group from `rest` nearest to its `places` (G, N, 3), by `masses` (G, N).

    Mueller, Heidelberger, Teschner & Gross 2005.
    """
    weight = masses[:, :, None]
    arms = [
        each - jnp.sum(weight * each, 1, keepdims=True) / jnp.sum(weight, 1, keepdims=True) for each in (places, rest)
    ]
    moment = jnp.einsum("gn,gni,gnj->gij", masses, *arms, precision=EXACT)
    return nearest_rotation(moment)


def _warped(system: GroupSystem, volumes: Array, positions: Array, rest: Array) -> Array:
    """R K (R'(x - x_cm) - (X - X_cm)) of each group, (G, N, 3) [N]: only differences within an element count."""
    corners, own = positions[system.cells], system.rotation[system.groups.element]
    way = jnp.einsum("eai,aje->eij", corners[:, 1:] - corners[:, :1], system.gradients[1:], precision=EXACT)
    strain = jnp.einsum("eki,ekj->eij", own, way, precision=EXACT) - jnp.eye(3, dtype=way.dtype)
    flat: Any = jnp.zeros((system.groups.nodes.size, 3), positions.dtype)
    forces = system.stress_forces(strain, own, volumes)
    pull: Array = flat.at[system.groups.slots].add(forces).reshape(*system.groups.nodes.shape, 3)
    return pull
