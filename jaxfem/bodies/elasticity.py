"""Corotated elasticity of linear tetrahedra: energy and forces at given positions."""

import jax

from jaxfem.bodies.elements import (
    Elements,
    RotationKind,
    deformation_gradient,
    rotated_strain,
    rotation_of,
    stress_force,
)
from jaxfem.bodies.material import eigenstiffness
from jaxfem.tensors import Matrix3

Array = jax.Array


def elastic_energy(
    elements: Elements, positions: Array, young: Array, poisson: Array, kind: RotationKind = "polar"
) -> Array:
    """Energy of each element, (E,) [J]: V/2 (3K e_v^2 + 2 mu sum e_d^2), e the rotated strain in the eigenbasis."""
    return elastic_response(elements, positions, young, poisson, kind)[0]


def elastic_response(
    elements: Elements, positions: Array, young: Array, poisson: Array, kind: RotationKind = "polar"
) -> tuple[Array, Array, Matrix3]:
    """Energy of each element (E,) [J], force on the nodes (n, 3) [N], and rotations: -V R S grad N_a, S the stress.

    With the nearest rotation the force is minus the gradient of the energy (stress and stretch share axes); with
    Gram-Schmidt it is the warped force of Mueller & Gross 2004, which has no energy.
    """
    deformation = deformation_gradient(elements, positions)
    rotation = rotation_of(deformation, kind)
    strain = rotated_strain(deformation, rotation)
    volumetric, deviatoric = eigenstiffness(young, poisson)
    impulse = [elements.volumes * w * s for w, s in zip([volumetric, *[deviatoric] * 5], strain, strict=True)]
    terms = [p * s for p, s in zip(impulse, strain, strict=True)]
    energy = 0.5 * sum(terms[1:], start=terms[0])
    return energy, stress_force(elements, rotation, [-p for p in impulse], positions.shape[0]), rotation
