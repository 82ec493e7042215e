"""Ways to solve a step, each known by its name once its module is imported."""

from jaxfem.methods.allrows.direct import Direct
from jaxfem.methods.allrows.mprgp import Mprgp
from jaxfem.methods.allrows.sweeps import Pgs
from jaxfem.methods.assembled import Assembled
from jaxfem.methods.base import METHODS, CannotServe, Facts, Method, Solved
from jaxfem.methods.groupwise import Groupwise
from jaxfem.methods.mass_spring import MassSpring
from jaxfem.methods.nodes.method import Condensed
from jaxfem.methods.nonlinear import ImplicitRotations
from jaxfem.registry import import_folder

__all__ = [
    "METHODS",
    "Assembled",
    "CannotServe",
    "Condensed",
    "Direct",
    "Facts",
    "Groupwise",
    "ImplicitRotations",
    "MassSpring",
    "Method",
    "Mprgp",
    "Pgs",
    "Solved",
]

import_folder(__name__, __path__)
