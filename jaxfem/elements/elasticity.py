"""Corotated elasticity: energy and forces at given positions, on domains of any kind."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxfem.elements import finite
from jaxfem.elements.domains import (
    DomainMaterial,
    Domains,
    domain_force,
    domain_gradient,
    domain_strains,
    row_means,
)
from jaxfem.elements.tetra import RotationKind
from jaxfem.tensors import Matrix3, inner, product, symmetric, to_eigenbasis, transposed

Array = jax.Array


def elastic_energy(
    kinds: Sequence[Domains], positions: Array, materials: Sequence[DomainMaterial], kind: RotationKind = "polar"
) -> Array:
    """Elastic energy of all domains at `positions` (n, 3), () [J]; `materials`: one for each kind."""
    return elastic_response(kinds, positions, materials, kind)[0]


def elastic_force(
    kinds: Sequence[Domains], positions: Array, materials: Sequence[DomainMaterial], kind: RotationKind = "polar"
) -> Array:
    """Elastic force of all domains on the nodes, (n, 3) [N]."""
    return elastic_response(kinds, positions, materials, kind)[1]


def elastic_response(
    kinds: Sequence[Domains], positions: Array, materials: Sequence[DomainMaterial], kind: RotationKind = "polar"
) -> tuple[Array, Array, list[Matrix3]]:
    """Energy () [J], force on the nodes (n, 3) [N], and each kind's rotations.

    Energy V/2 (3K e_v^2 + 2 mu sum e_d^2), e the rotated strain in the eigenbasis, plus the material's offset where it
    has one; force -V R S grad N_a, S the stress.
    With the nearest rotation the force is minus the gradient of the energy (stress and stretch share axes); with
    Gram-Schmidt it is the warped force of Mueller & Gross 2004, which has no energy. Laws that are not linear have
    their own energy, of the deformation gradient.
    """
    energy, force, rotations = jnp.zeros((), positions.dtype), jnp.zeros_like(positions), []
    strains = domain_strains(kinds, positions, kind)
    for each, (strain, rotation, _), material in zip(kinds, strains, materials, strict=True):
        if finite.of_energy(material):
            stored, pull = finite.response(each, positions, material)
            energy, force = energy + stored, force + pull
            rotations.append(rotation)
            continue
        strain = material.from_rest(strain)
        impulse = [each.row_volumes * w * s for w, s in zip(material.weights(each), strain, strict=True)]
        energy = energy + 0.5 * sum(inner(p, s) for p, s in zip(impulse, strain, strict=True))
        force = force + domain_force(each, rotation, [-p for p in impulse], positions.shape[0])
        rotations.append(rotation)
    return energy, force, rotations


def viscoelastic_force(
    kinds: Sequence[Domains],
    positions: Array,
    velocities: Array,
    materials: Sequence[DomainMaterial],
    kind: RotationKind = "polar",
) -> Array:
    """Force (n, 3) [N] of the stress D (e + offset + beta de/dt); `materials`: one for each kind."""
    force = jnp.zeros_like(positions)
    strains = domain_strains(kinds, positions, kind)
    for each, (strain, rotation, _), material in zip(kinds, strains, materials, strict=True):
        if finite.of_energy(material):
            force = force + finite.viscous_response(each, positions, velocities, material, rotation)
            continue
        rate = symmetric(product(transposed(rotation), domain_gradient(each, velocities)))
        rates = row_means(each, to_eigenbasis(rate)[each.rows])
        strain = material.from_rest(strain)
        times = material.damping if jnp.ndim(material.damping) == 2 else [material.damping] * len(strain)
        terms = zip(material.weights(each), strain, rates, times, strict=True)
        pull = [-each.row_volumes * w * (s + beta * r) for w, s, r, beta in terms]
        force = force + domain_force(each, rotation, pull, positions.shape[0])
    return force
