"""Corotated elasticity: energy and forces at given positions, on domains of any kind."""

import jax
import jax.numpy as jnp

from jaxfem.bodies.domains import (
    Domains,
    domain_force,
    domain_gradient,
    domain_stiffness,
    domain_strain,
    row_means,
)
from jaxfem.bodies.elements import RotationKind
from jaxfem.tensors import Matrix3, product, symmetric, to_eigenbasis, transposed

Array = jax.Array


def elastic_energy(
    domains: Domains, positions: Array, young: Array, poisson: Array, kind: RotationKind = "polar"
) -> Array:
    """Energy of each domain (D,), or cluster (C,) [J]: V/2 (3K e_v^2 + 2 mu sum e_d^2), e the rotated strain.

    e in the eigenbasis; `young` and `poisson`: () or one number an element of the model.
    """
    return elastic_response(domains, positions, young, poisson, kind)[0]


def elastic_response(
    domains: Domains, positions: Array, young: Array, poisson: Array, kind: RotationKind = "polar"
) -> tuple[Array, Array, Matrix3]:
    """Energy of each domain (D,) [J], force on the nodes (n, 3) [N], and rotations: -V R S grad N_a, S the stress.

    With the nearest rotation the force is minus the gradient of the energy (stress and stretch share axes); with
    Gram-Schmidt it is the warped force of Mueller & Gross 2004, which has no energy.
    """
    strain, rotation, _ = domain_strain(domains, positions, kind)
    volumetric, deviatoric = domain_stiffness(domains, young, poisson)
    weights = [volumetric, *[deviatoric] * 5][domains.rows]
    impulse = [domains.row_volumes * w * s for w, s in zip(weights, strain, strict=True)]
    terms = [p * s for p, s in zip(impulse, strain, strict=True)]
    energy = 0.5 * sum(terms[1:], start=terms[0])
    return energy, domain_force(domains, rotation, [-p for p in impulse], positions.shape[0]), rotation


def elastic_force(
    domains: tuple[Domains, ...], positions: Array, young: Array, poisson: Array, kind: RotationKind = "polar"
) -> Array:
    """Elastic force of all domains on the nodes, (n, 3) [N]."""
    parts = (elastic_response(each, positions, young, poisson, kind)[1] for each in domains)
    return sum(parts, start=jnp.zeros_like(positions))


def viscoelastic_force(
    domains: Domains,
    positions: Array,
    velocities: Array,
    stiffness: tuple[Array, Array],
    damping: Array,
    kind: RotationKind = "polar",
) -> Array:
    """Force (n, 3) [N] of the stress D (e + beta de/dt); `stiffness` (3K, 2 mu) and `damping` () or (D,)."""
    strain, rotation, _ = domain_strain(domains, positions, kind)
    rate = symmetric(product(transposed(rotation), domain_gradient(domains, velocities)))
    rates = row_means(domains, to_eigenbasis(rate)[domains.rows])
    weights = [stiffness[0], *[stiffness[1]] * 5][domains.rows]
    pull = [-domains.row_volumes * w * (s + damping * r) for w, s, r in zip(weights, strain, rates, strict=True)]
    return domain_force(domains, rotation, pull, positions.shape[0])
