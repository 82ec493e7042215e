"""Stable neo-Hookean elasticity: rubber at large strain, with finite forces that restore flat and inverted elements."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.materials.base import Pair, Values
from jaxfem.materials.invariants import first_invariant, volume_change
from jaxfem.materials.linear import DAMPING, POISSON, YOUNG
from jaxfem.materials.moduli import eigenstiffness, shear_modulus
from jaxfem.materials.nonlinear import Nonlinear
from jaxfem.tensors import Matrix3

Array = jax.Array


class NeoHookean(Nonlinear, word="neo_hookean"):
    """The energy of Smith, de Goes & Kim 2018; `young` [Pa] and `poisson` are those of small strains.

    With m = 4/3 mu and l = lambda + 5/6 mu, mu and lambda the constants of Lame,
        W = m/2 (|F|^2 - 3) - m/2 log((|F|^2 + 1)/4) - 3/4 m (J - 1) + l/2 (J - 1)^2,
    which is theirs less a constant. Its bulk modulus is K = l - mu/6, so the change of shape keeps mu/12 (J - 1)^2.
    `damping` beta [s]: as in the linear law, stress D beta de/dt beside.
    """

    constants = (YOUNG, POISSON, DAMPING)

    def __init__(self, young: Any = None, poisson: Any = None, damping: Any = None):
        super().__init__(young=young, poisson=poisson, damping=damping)

    def stiffness(self, values: Values) -> Pair:
        """(3K, 2 mu) [Pa] at rest."""
        return eigenstiffness(values["young"], values["poisson"])

    def distortion(self, values: Values, gradient: Matrix3, internal: Any, dt: Any) -> Array:
        """W less K/2 (J - 1)^2 [J/m^3]."""
        mu = shear_modulus(values["young"], values["poisson"])
        grown, change = first_invariant(gradient), volume_change(gradient)
        return mu * (2 / 3 * (grown - jnp.log1p(0.25 * grown)) - change + change * change / 12)
