"""Isotropic linear elasticity: its constants from Young's modulus and Poisson's ratio, and back."""

import jax

Array = jax.Array


def shear_modulus(young: Array, poisson: Array) -> Array:
    """Second Lame constant mu = E / (2 (1 + nu)) [Pa]."""
    return young / (2 * (1 + poisson))


def bulk_modulus(young: Array, poisson: Array) -> Array:
    """K = E / (3 (1 - 2 nu)) [Pa]."""
    return young / (3 * (1 - 2 * poisson))


def eigenstiffness(young: Array, poisson: Array) -> tuple[Array, Array]:
    """The two distinct eigenvalues of the isotropic stiffness in the Kelvin-Mandel basis, (3K, 2 mu) [Pa]."""
    return 3 * bulk_modulus(young, poisson), 2 * shear_modulus(young, poisson)


def ratio_and_modulus(volumetric: Array, deviatoric: Array) -> tuple[Array, Array]:
    """Poisson's ratio and Young's modulus [Pa] of the eigenvalues (3K, 2 mu): the inverse of `eigenstiffness`."""
    total = 2 * volumetric + deviatoric
    return (volumetric - deviatoric) / total, 3 * volumetric * deviatoric / total


def stiffness_of_shear(shear: Array, poisson: Array) -> tuple[Array, Array]:
    """The eigenvalues (3K, 2 mu) [Pa] of a shear modulus [Pa] and Poisson's ratio: 3K = 2 mu (1 + nu)/(1 - 2 nu)."""
    return 2 * shear * (1 + poisson) / (1 - 2 * poisson), 2 * shear
