"""A pressure that follows the surface."""

from typing import Any

import jax.numpy as jnp

from jaxfem.declared.loads.base import Load, Loaded, surface_faces
from jaxfem.loads import FacePressure, ResolvedLoad
from jaxfem.pytrees import on_device


class Pressure(Load, kind="pressure"):
    """Follower `pressure` [Pa] on `faces`: pushes against the outward normal of the deformed faces."""

    faces: Any
    pressure: Any

    place = "faces"
    amount = "pressure"
    unit = "Pa"
    scalar = True

    def resolved(self, body: Loaded, offset: int, dtype: Any) -> ResolvedLoad:
        """The faces themselves: areas and normals are those of the moment."""
        faces = surface_faces(body, self.faces)
        self.checked(body, "pressure", ())
        return FacePressure(on_device(faces + offset, jnp.int32))
