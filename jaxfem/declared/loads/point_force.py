"""A force at a material point."""

from typing import Any

import numpy as np

from jaxfem.declared.errors import SceneError
from jaxfem.declared.loads.base import Load, Loaded, weighted
from jaxfem.loads import ResolvedLoad
from jaxfem.mesh import locate


class PointForce(Load, kind="point_force"):
    """Dead `force` (3,) [N] at the material `point` (3,) [m] of the undeformed body, inside a tetrahedron."""

    point: Any
    force: Any

    place = "point"
    amount = "force"
    unit = "N"

    def resolved(self, body: Loaded, offset: int, dtype: Any) -> ResolvedLoad:
        """Shares by barycentric coordinates at the corners of the tetrahedron around the point."""
        point, mesh = self.checked(body, "point", (3,)), body.mesh
        self.checked(body, "force", (3,))
        cell, weights, distance = locate(mesh.points, mesh.cells, point[None])
        if distance[0] > 1e-6 * np.ptp(mesh.points, axis=0).max():
            raise SceneError(
                f'a PointForce of "{body.label}" acts at {tuple(self.point)}, {distance[0]:.3g} m outside the body'
            )
        return weighted(mesh.cells[cell[0]] + offset, weights[0], dtype)
