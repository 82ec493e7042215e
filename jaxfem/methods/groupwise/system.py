"""A step's equations, group by group and for the whole: one rotation a group, by mass-weighted shape matching.

With the group's rotation R, its force R K (R'(x - x_cm) - (X - X_cm)), damping alpha M + beta K and x1 = x0 + dt v, a
group j has, in place of (7) of Wang, Xu & Hasegawa,
    A_j v_j = M_j v0 + dt (f_j - R K_j (R'(x0 - x_cm) - (X - X_cm))) + dt f_c,
    A_j = (1 + dt alpha) M_j + dt (dt + beta) R K_j R'
which is their (7) with x = x0 + dt v and the predicted place of (6) put in. K_j takes no notice of x_cm, whichever way
it is distributed: the matrix M_cm of (9) drops out, as a product K_j M_cm is zero, and A_j is symmetric. In the group's
own frame A_j is constant. Where a node's copies in several groups are one, the sum of these equations is the step's.
"""

import jax
import jax.numpy as jnp

from jaxfem.elements.tetra import tetra_gradient
from jaxfem.methods.assembled import lame
from jaxfem.methods.groupwise.plan import Groups
from jaxfem.methods.node_blocks import rounding_floor
from jaxfem.model import Model, Params, State, element_damping, nodal_mass, per_element
from jaxfem.pytrees import Pytree
from jaxfem.rotation import nearest_rotation
from jaxfem.system.drag import nodal_drag
from jaxfem.system.soft import external_force, prescribed_velocity
from jaxfem.tensors import EXACT, Matrix3, array_of, matrix_of, product, symmetric, times, transposed

Array = jax.Array


class GroupSystem(Pytree):
    """A step of all groups, element by element.

    `cells` (E, 4), `gradients` (4, 3, E); `rotation` (G, 3, 3) and, of each element's group, `turn` (3, 3, E);
    `inertia` (G, N) [kg]: (1 + dt alpha) times masses of the copies, `mass` (n,) their sums, `share` (G, N) of a node's
    mass; `strain` (3, 3, E): R'F - I at the start; `reach` (E,) dt + beta [s], `span` (E,) dt times the volume [m^3 s],
    `lam` and `shear` (E,) [Pa]; `load` (n, 3): M v0 + dt f [N s]; `prescribed` (n, 3) [m/s]; `free` (n, 1).
    """

    groups: Groups
    cells: Array
    gradients: Array
    rotation: Array
    turn: Array
    inertia: Array
    mass: Array
    share: Array
    strain: Array
    reach: Array
    span: Array
    lam: Array
    shear: Array
    load: Array
    prescribed: Array
    free: Array
    floor: Array
    tolerance: Array
    max_iterations: Array

    def gradient(self, unknown: Array) -> Array:
        """The residual (n, 3) of nodes whose copies are one; what is not free carries its mass."""
        velocities = self.merged(unknown)
        strain = self._strain(velocities, self.cells) + self.strain
        left = self.mass[:, None] * velocities - self.load + self._pushed(strain, self.cells, len(velocities))
        return jnp.where(self.free, left, self.mass[:, None] * unknown)

    def product(self, vector: Array) -> Array:
        """The derivative of `gradient` times (n, 3)."""
        moving = jnp.where(self.free, vector, 0)
        pulled = self._pushed(self._strain(moving, self.cells), self.cells, len(vector))
        return self.mass[:, None] * vector + jnp.where(self.free, pulled, 0)

    def copies_product(self, field: Array) -> Array:
        """A of each group times a field of copies (G, N, 3)."""
        flat, slots = field.reshape(-1, 3), self.groups.slots
        pulled = self._pushed(self._strain(flat, slots), slots, len(flat))
        return self.inertia[:, :, None] * field + pulled.reshape(field.shape)

    def copies_right(self) -> Array:
        """Right-hand side of each group by itself, (G, N, 3) [N s]; a node's load goes by mass."""
        pulled = self._pushed(self.strain, self.groups.slots, self.groups.nodes.size)
        return self.share[:, :, None] * self.spread(self.load) - pulled.reshape(*self.groups.nodes.shape, 3)

    def spread(self, field: Array) -> Array:
        """A nodal field (n, 3) on the copies."""
        return field[self.groups.nodes]

    def means(self, copies: Array) -> Array:
        """Means (n, 3) of the copies (G, N, 3), by their masses."""
        return jnp.zeros_like(self.prescribed).at[self.groups.nodes].add(self.share[:, :, None] * copies)

    def merged(self, unknown: Array) -> Array:
        """Velocities of all nodes from the unknown on the free ones."""
        return jnp.where(self.free, unknown, self.prescribed)

    def _strain(self, field: Array, cells: Array) -> Array:
        """(dt + beta) R' grad of a velocity field (m, 3) with the elements' corners at `cells`, (3, 3, E)."""
        rate = tetra_gradient(cells, self.gradients, field)
        return self.reach * array_of(product(transposed(matrix_of(self.turn)), rate))

    def _pushed(self, strain: Array, cells: Array, count: int) -> Array:
        """dt V R S grad N_a at the corners, S the stress of sym(strain), summed to (count, 3)."""
        stress = _stress(strain, self.span * self.lam, self.span * self.shear)
        return _nodal_sums(self.gradients, self.turn, stress, cells, count)


def _stress(strain: Array, lam: Array, shear: Array) -> Matrix3:
    """Stress of the even part of a strain (3, 3, E) in the rotated frame, by Lame's constants (E,)."""
    even = symmetric(matrix_of(strain))
    pressure = lam * (even[0][0] + even[1][1] + even[2][2])
    return [[2 * shear * even[i][j] + (pressure if i == j else 0) for j in range(3)] for i in range(3)]


def _nodal_sums(gradients: Array, turn: Array, stress: Matrix3, cells: Array, count: int) -> Array:
    """R S grad N_a at the corners, S a stress times volumes, summed to (count, 3)."""
    turned = product(matrix_of(turn), stress)
    others = jnp.stack([jnp.stack(times(turned, gradients[a])) for a in (1, 2, 3)])
    # The first corner takes the reaction, so that forces sum to zero to the last digit.
    forces = jnp.concatenate([-jnp.sum(others, axis=0, keepdims=True), others]).transpose(2, 0, 1)
    return jnp.zeros((count, 3), forces.dtype).at[cells].add(forces)


def group_elasticity(model: Model, params: Params, positions: Array, rates: Array) -> tuple[Array, Array, Array]:
    """Energy [J], force (n, 3) [N] with that of damping, and the power [W] of damping, at `positions` (n, 3) and their
    `rates`: those of strain in the groups' frames."""
    elements, volumes = model.elements, model.elements.volumes
    beta, (lam, shear) = element_damping(model, params), lame(model, params)
    turn = _turns(model, params, positions)
    strain = array_of(_start_strain(elements.cells, elements.gradients, positions, turn))
    moved = tetra_gradient(elements.cells, elements.gradients, rates)
    rate = array_of(product(transposed(matrix_of(turn)), moved))
    elastic, viscous = (array_of(_stress(each, lam, shear)) for each in (strain, beta * rate))
    pulled = _nodal_sums(elements.gradients, turn, matrix_of(volumes * (elastic + viscous)), elements.cells, len(rates))
    return 0.5 * jnp.sum(volumes * elastic * strain), -pulled, jnp.sum(volumes * viscous * rate)


def _turns(model: Model, params: Params, positions: Array) -> Array:
    """The groups' rotations, of each element (3, 3, E)."""
    groups: Groups = model.plan
    rotation = shape_matching(_group_masses(model, params), positions[groups.nodes], model.rest[groups.nodes])
    return jnp.moveaxis(rotation, 0, -1)[:, :, groups.element]


def group_system(model: Model, params: Params, state: State, dt: Array, forces: Array | None) -> GroupSystem:
    """The equations at the head of this file, made at the start of the step."""
    groups: Groups = model.plan
    elements, x = model.elements, state.positions
    moduli = *lame(model, params), element_damping(model, params)
    lam, shear, beta = (jnp.broadcast_to(each, elements.volumes.shape) for each in moduli)
    copies, masses = _group_masses(model, params), nodal_mass(model, params.density)
    rotation = shape_matching(copies, x[groups.nodes], model.rest[groups.nodes])
    turn = jnp.moveaxis(rotation, 0, -1)[:, :, groups.element]
    load = dt * external_force(model, params, x, forces)
    drag = 1 + dt * nodal_drag(model, params)
    return GroupSystem(
        groups=groups,
        cells=elements.cells,
        gradients=elements.gradients,
        rotation=rotation,
        turn=turn,
        inertia=copies * drag[groups.nodes],
        mass=masses * drag,
        share=copies / masses[groups.nodes],
        strain=array_of(_start_strain(elements.cells, elements.gradients, x, turn)),
        reach=dt + beta,
        span=dt * elements.volumes,
        lam=lam,
        shear=shear,
        load=masses[:, None] * state.velocities + load,
        prescribed=prescribed_velocity(model, params, state, dt),
        free=model.free[:, None] > 0,
        floor=rounding_floor(masses, load, state.velocities),
        tolerance=model.tolerance,
        max_iterations=model.max_iterations,
    )


def _start_strain(cells: Array, gradients: Array, positions: Array, turn: Array) -> Matrix3:
    """R'F - I: only differences within an element count, so the groups' centres drop out."""
    stretch = product(transposed(matrix_of(turn)), tetra_gradient(cells, gradients, positions))
    return [[stretch[i][j] - (1.0 if i == j else 0.0) for j in range(3)] for i in range(3)]


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
