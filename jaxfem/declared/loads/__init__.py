"""Loads as a user declares them, one kind a file; `base` says what each of them offers."""

from jaxfem.declared.loads.base import LOADS, Load
from jaxfem.declared.loads.nodal_force import NodalForce
from jaxfem.declared.loads.point_force import PointForce
from jaxfem.declared.loads.pressure import Pressure
from jaxfem.declared.loads.traction import Traction
from jaxfem.registry import import_folder

__all__ = ["LOADS", "Load", "NodalForce", "PointForce", "Pressure", "Traction"]

import_folder(__name__, __path__)
