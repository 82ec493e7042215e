"""Loads that a user declares on a body, and the forces they give on its nodes."""

from jaxfem.loads.declared import Load, NodalForce, PointForce, Pressure, Traction
from jaxfem.loads.forces import FacePressure, WeightedForce, load_force

__all__ = ["FacePressure", "Load", "NodalForce", "PointForce", "Pressure", "Traction", "WeightedForce", "load_force"]
