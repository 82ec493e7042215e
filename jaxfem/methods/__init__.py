"""Ways to solve a step, each known by its name once its module is imported."""

from jaxfem.methods.allrows.direct import Direct
from jaxfem.methods.allrows.mprgp import Mprgp
from jaxfem.methods.allrows.sweeps import Pgs
from jaxfem.methods.base import METHODS, CannotServe, Facts, Method, Solved
from jaxfem.methods.nodes.method import Condensed
from jaxfem.methods.nonlinear import ImplicitRotations
from jaxfem.registry import import_folder

__all__ = [
    "METHODS",
    "CannotServe",
    "Condensed",
    "Direct",
    "Facts",
    "ImplicitRotations",
    "Method",
    "Mprgp",
    "Pgs",
    "Solved",
]

import_folder(__name__, __path__)
