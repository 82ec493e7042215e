"""Elastic rows: each element's stress as regularised constraint rows, in the constant eigenbasis of isotropy."""

import jax
import jax.numpy as jnp

from jaxfem.bodies.elements import (
    Elements,
    RotationKind,
    deformation_gradient,
    gradient_of,
    rotated_strain,
    rotation_of,
    stress_force,
)
from jaxfem.bodies.material import eigenstiffness
from jaxfem.pytrees import pytree, static
from jaxfem.tensors import EIGENBASIS, array_of, matrix_of, product, symmetric, to_eigenbasis, transposed

Array = jax.Array


@pytree
class ElasticRows:
    """Six rows an element, arrays of shape (6, E): row 0 volumetric, rows 1 to 5 deviatoric; never at a bound."""

    elements: Elements
    rotation: Array  # (3, 3, E)
    compliance: Array  # (6, E) [1/(J s^2)]: a row's impulse is stress times volume times time, J s
    bias: Array  # (6, E) [1/s]
    nodes: int = static()

    bounds = None

    def apply(self, velocities: Array) -> Array:
        """Rate of the rotated strain, sym(R' grad v), with R held: (n, 3) [m/s] -> (6, E) [1/s]."""
        rotation = matrix_of(self.rotation)
        rate = symmetric(product(transposed(rotation), gradient_of(self.elements, velocities)))
        return jnp.stack(to_eigenbasis(rate))

    def apply_transpose(self, impulses: Array) -> Array:
        """Nodal impulses R S grad N_a of row impulses (6, E), S their symmetric matrix: -> (n, 3)."""
        coefficients = [impulses[r] for r in range(6)]
        return stress_force(self.elements, matrix_of(self.rotation), coefficients, self.nodes)

    def diagonal(self, inverse_mass: Array) -> Array:
        """Diagonal of J M^-1 J': sum_a |s_r grad N_a|^2 / m_a; rotation drops out."""
        corner = inverse_mass[self.elements.cells].T
        spread = jnp.einsum("rij,aje->raie", jnp.asarray(EIGENBASIS, corner.dtype), self.elements.gradients)
        return jnp.einsum("raie,raie,ae->re", spread, spread, corner)


def elastic_rows(
    elements: Elements,
    positions: Array,
    young: Array,
    poisson: Array,
    damping: Array,
    dt: Array,
    kind: RotationKind = "polar",
) -> ElasticRows:
    """Rows of one backward Euler step from `positions` (n, 3); material values are (E,).

    With e the rotated strain and D the stiffness, the stress impulse at the end of the step is
        lam = -dt V D (e + (dt + beta) J v)   =>   C = 1 / (D V dt (dt + beta)),   c = -e / (dt + beta)
    (Benevolensky & Voroshilov 2009, section 2, with design.md's corrections).
    """
    deformation = deformation_gradient(elements, positions)
    rotation = rotation_of(deformation, kind)
    strain = rotated_strain(deformation, rotation)
    volumetric, deviatoric = eigenstiffness(young, poisson)
    scale = 1 / (elements.volumes * dt * (dt + damping))
    compliance = jnp.stack([scale / volumetric, *[scale / deviatoric] * 5])
    bias = jnp.stack([-s / (dt + damping) for s in strain])
    return ElasticRows(elements, array_of(rotation), compliance, bias, positions.shape[0])
