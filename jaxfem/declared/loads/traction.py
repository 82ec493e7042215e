"""A force per area that keeps its direction."""

from typing import Any

import numpy as np

from jaxfem.declared.loads.base import Load, Loaded, surface_faces, weighted
from jaxfem.loads import AreaForce, ResolvedLoad


class Traction(Load, kind="traction"):
    """Dead `traction` (3,) [Pa], force per *undeformed* area, on `faces` (a group's name or (k, 3) node indices)."""

    faces: Any
    traction: Any

    place = "faces"
    amount = "traction"
    unit = "Pa"

    def resolved(self, body: Loaded, offset: int, dtype: Any) -> ResolvedLoad:
        """A third of each face's area at each of its corners."""
        faces = surface_faces(body, self.faces)
        self.checked(body, "traction", (3,))
        a, b, c = (body.mesh.points[faces[:, i]] for i in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        shares = weighted(faces.ravel() + offset, np.repeat(area / 3, 3), dtype)
        return AreaForce(shares.nodes, shares.weights)
