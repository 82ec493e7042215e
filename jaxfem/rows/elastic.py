"""Elastic rows: each domain's stress as regularised constraint rows, in the constant eigenbasis of isotropy."""

import jax
import jax.numpy as jnp

from jaxfem.bodies.domains import Domains, domain_force, domain_gradient, domain_strain
from jaxfem.bodies.elements import RotationKind
from jaxfem.pytrees import pytree, static
from jaxfem.tensors import EIGENBASIS, array_of, matrix_of, product, symmetric, to_eigenbasis, transposed

Array = jax.Array


@pytree
class ElasticRows:
    """The r rows a domain of the part of the strain that is taken there, arrays of shape (r, D); never at a bound.

    Full: row 0 volumetric, rows 1 to 5 deviatoric. Deviatoric: the last five. Volumetric: the first.
    """

    domains: Domains
    rotation: Array  # (3, 3, D)
    compliance: Array  # (r, D) [1/(J s^2)]: a row's impulse is stress times volume times time, J s
    bias: Array  # (r, D) [1/s]
    nodes: int = static()

    bounds = None

    def apply(self, velocities: Array) -> Array:
        """Rate of the rotated strain, sym(R' grad v), with R held: (n, 3) [m/s] -> (r, D) [1/s]."""
        rotation = matrix_of(self.rotation)
        rate = symmetric(product(transposed(rotation), domain_gradient(self.domains, velocities)))
        return jnp.stack(to_eigenbasis(rate)[self.domains.rows])

    def apply_transpose(self, impulses: Array) -> Array:
        """Nodal impulses R S grad N_a of row impulses (r, D), S their symmetric matrix: -> (n, 3)."""
        return domain_force(self.domains, matrix_of(self.rotation), list(impulses), self.nodes)

    def diagonal(self, inverse_mass: Array) -> Array:
        """Diagonal of J M^-1 J': sum_a |s_r grad N_a|^2 / m_a; rotation drops out."""
        corner = inverse_mass[self.domains.cells].T
        basis = jnp.asarray(EIGENBASIS[self.domains.rows], corner.dtype)
        spread = jnp.einsum("rij,aje->raie", basis, self.domains.gradients)
        return jnp.einsum("raie,raie,ae->re", spread, spread, corner)


def elastic_rows(
    domains: Domains,
    positions: Array,
    stiffness: tuple[Array, Array],
    damping: Array,
    dt: Array,
    kind: RotationKind = "polar",
) -> ElasticRows:
    """Rows of one backward Euler step from `positions` (n, 3); `stiffness` (3K, 2 mu) [Pa] and `damping` () or (D,).

    With e the rotated strain and D the stiffness, the stress impulse at the end of the step is
        lam = -dt V D (e + (dt + beta) J v)   =>   C = 1 / (D V dt (dt + beta)),   c = -e / (dt + beta)
    (Benevolensky & Voroshilov 2009, section 2, with design.md's corrections).
    """
    strain, rotation, _ = domain_strain(domains, positions, kind)
    scale = 1 / (domains.volumes * dt * (dt + damping))
    volumetric, deviatoric = stiffness
    compliance = jnp.stack([scale / volumetric, *[scale / deviatoric] * 5][domains.rows])
    bias = jnp.stack([-s / (dt + damping) for s in strain])
    return ElasticRows(domains, array_of(rotation), compliance, bias, positions.shape[0])
