"""Yeoh's law: rubber and silicone up to several hundred per cent, a cubic in the first invariant."""

from typing import Any

import jax
import numpy as np

from jaxfem.materials.base import Pair, Values
from jaxfem.materials.constants import Constant, Signed
from jaxfem.materials.invariants import first_of_shape
from jaxfem.materials.linear import DAMPING, POISSON
from jaxfem.materials.moduli import stiffness_of_shear
from jaxfem.materials.nonlinear import Nonlinear
from jaxfem.tensors import Matrix3

Array = jax.Array

C1 = Constant(
    "c1",
    "Pa",
    "must be > 0 Pa; Young's modulus at small strains is about 6 c1",
    label="Yeoh constant C1",
    low=0.0,
    plausible=(1e-1, 1e12),
    stiffness=True,
)
C2 = Constant(
    "c2",
    "Pa",
    "must be a finite number of Pa, usually 1e-2 of c1",
    label="Yeoh constant C2",
    default=0.0,
    transform=Signed(size=1e2),
    bounds=(-1e6, 1e6),
    absolute=True,
)
C3 = Constant(
    "c3",
    "Pa",
    "must be a finite number of Pa, usually 1e-4 to 1e-3 of c1",
    label="Yeoh constant C3",
    default=0.0,
    transform=Signed(size=1.0),
    bounds=(-1e5, 1e5),
    absolute=True,
)


class Yeoh(Nonlinear, word="yeoh"):
    """W = c1 x + c2 x^2 + c3 x^3 + K/2 (J - 1)^2, x = I1' - 3, I1' = |F|^2 / J^(2/3)   (Yeoh 1993).

    The power goes on as a parabola below J = 1/4. `c1`, `c2`, `c3` [Pa]; mu = 2 c1, and K follows from it and
    `poisson`. `damping` beta [s]: as in the linear law. With negative c2 or c3 the law softens far out: where
    c1 + 2 c2 x + 3 c3 x^2 falls to zero nothing holds the material any more.
    """

    constants = (C1, C2, C3, POISSON, DAMPING)

    def __init__(self, c1: Any = None, c2: Any = None, c3: Any = None, poisson: Any = None, damping: Any = None):
        super().__init__(c1=c1, c2=c2, c3=c3, poisson=poisson, damping=damping)

    def doubts(self) -> tuple[str, ...]:
        """Where it softens so early that a slip of signs or units is likelier than a material."""
        numbers = [np.asarray(self.values[name], float) for name in ("c1", "c2", "c3")]
        found = [end for end in map(_end_of_hold, *map(np.ravel, np.broadcast_arrays(*numbers))) if end < EARLY]
        if not found:
            return ()
        return (
            f"holds up to a stretch of {min(found):.3g} alone, where c1 + 2 c2 x + 3 c3 x^2 falls to zero (silicones: "
            "5 or more): check signs and units of c2 and c3",
        )

    def stiffness(self, values: Values) -> Pair:
        """(3K, 2 mu) [Pa] at rest."""
        return stiffness_of_shear(2 * values["c1"], values["poisson"])

    def distortion(self, values: Values, gradient: Matrix3, internal: Any, dt: Any) -> Array:
        """W less K/2 (J - 1)^2 [J/m^3]."""
        x = first_of_shape(gradient)
        return x * (values["c1"] + x * (values["c2"] + x * values["c3"]))


EARLY = 2.0
"""Stretch of a pulled bar within which a law that gives way is warned of."""


def _end_of_hold(c1: float, c2: float, c3: float) -> float:
    """Stretch of a pulled incompressible bar at which c1 + 2 c2 x + 3 c3 x^2 is zero, x = s^2 + 2/s - 3."""
    roots = np.roots([3 * c3, 2 * c2, c1])
    ends = [float(root.real) for root in roots if abs(root.imag) < 1e-9 * abs(root) and root.real > 0]
    if not ends:
        return float("inf")
    return float(np.roots([1, 0, -(min(ends) + 3), 2]).real.max())
