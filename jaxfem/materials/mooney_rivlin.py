"""Mooney-Rivlin elasticity: rubber at moderate strain, linear in both invariants."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from jaxfem.materials.base import Pair, Values
from jaxfem.materials.constants import Constant, Signed
from jaxfem.materials.invariants import first_of_shape, second_of_shape
from jaxfem.materials.linear import DAMPING, POISSON
from jaxfem.materials.moduli import stiffness_of_shear
from jaxfem.materials.nonlinear import Nonlinear
from jaxfem.ranges import Range
from jaxfem.tensors import Matrix3

Array = jax.Array

C10 = Constant(
    "c10",
    "Pa",
    "must be > 0 Pa; the shear modulus is 2 (c10 + c01)",
    label="Mooney-Rivlin constant C10",
    low=0.0,
    plausible=(1e-1, 1e12),
    stiffness=True,
)
C01 = Constant(
    "c01",
    "Pa",
    "must be a finite number of Pa; 0 makes the law neo-Hookean",
    label="Mooney-Rivlin constant C01",
    transform=Signed(size=1e2),
    bounds=(-1e7, 1e7),
    absolute=True,
)
HALF_SHEAR = Range(low=0.0, open_low=True, advice="must be > 0 Pa: half the shear modulus")
EARLY = 0.5
"""Share of its length down to which a pressed bar should hold."""


class MooneyRivlin(Nonlinear, word="mooney_rivlin"):
    """W = c10 (I1' - 3) + c01 (I2' - 3) + K/2 (J - 1)^2, I' the invariants of the shape (Mooney 1940, Rivlin 1948).

    I1' = |F|^2 / J^(2/3), I2' = |cof F|^2 / J^(4/3), the powers going on as parabolas below J = 1/4. `c10`, `c01` [Pa];
    mu = 2 (c10 + c01) must be positive, and K follows from it and `poisson`. `damping` beta [s]: as in the linear law.
    """

    constants = (C10, C01, POISSON, DAMPING)

    def __init__(self, c10: Any = None, c01: Any = None, poisson: Any = None, damping: Any = None):
        super().__init__(c10=c10, c01=c01, poisson=poisson, damping=damping)

    def combined(self, values: Values) -> Mapping[str, tuple[Any, Range]]:
        """Half the shear modulus."""
        return {"c10 + c01": (values["c10"] + values["c01"], HALF_SHEAR)}

    def doubts(self) -> tuple[str, ...]:
        """Where a negative c01 lets it give way early under pressure."""
        c10, c01 = (np.asarray(self.values[name], float) for name in ("c10", "c01"))
        end = float(np.max(-c01 / c10))
        if end < EARLY:
            return ()
        return (f"gives way where it is pressed to {end:.3g} of its length, as c01 is negative: check its sign",)

    def stiffness(self, values: Values) -> Pair:
        """(3K, 2 mu) [Pa] at rest."""
        return stiffness_of_shear(2 * (values["c10"] + values["c01"]), values["poisson"])

    def distortion(self, values: Values, gradient: Matrix3, internal: Any, dt: Any) -> Array:
        """W less K/2 (J - 1)^2 [J/m^3]."""
        return values["c10"] * first_of_shape(gradient) + values["c01"] * second_of_shape(gradient)
