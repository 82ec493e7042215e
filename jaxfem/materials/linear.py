"""Isotropic linear elasticity with stiffness-proportional damping: the law of a body that names no other."""

from typing import Any

from jaxfem.materials.base import Material, Pair, Values
from jaxfem.materials.constants import Constant, Logistic
from jaxfem.materials.moduli import eigenstiffness

YOUNG = Constant(
    "young",
    "Pa",
    "must be > 0 Pa (soft silicone: 1e5, steel: 2e11)",
    label="Young's modulus",
    low=0.0,
    plausible=(1e0, 1e13),
    stiffness=True,
)
POISSON = Constant(
    "poisson",
    "",
    "must lie strictly between -1 and 0.5; for a nearly incompressible material use 0.49 or 0.499",
    label="Poisson's ratio",
    low=-1.0,
    high=0.5,
    transform=Logistic(-1.0, 0.5),
    bounds=(-0.95, 0.4995),
    absolute=True,
    doubt=(
        0.0,
        "few materials widen when pulled: rather, these samples hardly depend on it and something else that the model "
        "lacks decides. Hold it at a known value",
    ),
)
DAMPING = Constant(
    "damping",
    "s",
    "must be >= 0; it is the time beta in seconds of C = beta K, typically 1e-4 to 1e-2",
    label="damping",
    low=0.0,
    closed=True,
    plausible=(0.0, 10.0),
    default=0.0,
    bounds=(1e-4, 1e4),
    viscous=True,
)


class Linear(Material, word="linear"):
    """Stress D (e + beta de/dt), D of Young's modulus `young` [Pa] and Poisson's ratio `poisson`, beta `damping` [s].

    Each one number, or one an element.
    """

    constants = (YOUNG, POISSON, DAMPING)

    def __init__(self, young: Any = None, poisson: Any = None, damping: Any = None):
        super().__init__(young=young, poisson=poisson, damping=damping)

    def stiffness(self, values: Values) -> Pair:
        """(3K, 2 mu) [Pa]."""
        return eigenstiffness(values["young"], values["poisson"])
