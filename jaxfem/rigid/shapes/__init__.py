"""Shapes of rigid bodies and ground: mass properties, distance, and the points that touch others."""

from jaxfem.registry import import_folder
from jaxfem.rigid.shapes.base import SHAPES, MassProperties, Shape
from jaxfem.rigid.shapes.ground import HeightField, Plane, SignedDistance
from jaxfem.rigid.shapes.solids import Box, Capsule, Cylinder, Sphere
from jaxfem.rigid.shapes.surface import TriangleMesh

__all__ = [
    "SHAPES",
    "Box",
    "Capsule",
    "Cylinder",
    "HeightField",
    "MassProperties",
    "Plane",
    "Shape",
    "SignedDistance",
    "Sphere",
    "TriangleMesh",
]

import_folder(__name__, __path__)
