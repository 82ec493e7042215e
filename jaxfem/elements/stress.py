"""Stress of isotropic elasticity in the rotated frame, for display."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxfem.elements.tetra import Elements, RotationKind, deformation_gradient, rotated_strain, rotation_of

Array = jax.Array


@partial(jax.jit, static_argnames="kind")
def von_mises_stress(elements: Elements, positions: Array, deviatoric: Array, kind: RotationKind = "polar") -> Array:
    """Von Mises stress of each element, (E,) [Pa]: sqrt(3/2 s:s), s the deviator of the rotated stress.

    `positions` (n, 3) [m]; `deviatoric`: stiffness 2 mu, a number or (E,) [Pa]. Elastic stress only, without damping.
    """
    deformation = deformation_gradient(elements, positions)
    strain = rotated_strain(deformation, rotation_of(deformation, kind))
    # The eigenbasis is orthonormal and its first row volumetric: s:s is the sum of the other coefficients squared.
    return deviatoric * jnp.sqrt(1.5 * sum(each**2 for each in strain[1:]))
