"""Points of any body, or of ground, against the surface of a soft body.

Nodes of two soft bodies of one mesh lie on each other, rim on rim: what is a hair beyond the other's edge is as near to
the face beside it as to the one that carries it. It meets the one that its own surface looks at.
"""

import dataclasses
from typing import Any

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration, SoftPoint, difference
from jaxfem.rows.candidates import Candidates, Pairs
from jaxfem.rows.contact import SAID_AGAIN
from jaxfem.rows.triangles import ASIDE, areas_around, gap_from, nearest_triangle


class SurfaceContacts(Candidates):
    """Points of any body or of ground against the surface of a soft body: each against the triangle nearest to it.

    `points` (m); `triangles` (m, t, 3): nodes of those that each may meet, turned outward; `around` (m, f, 3): those of
    the point's own surface that it lies on, padded with points, None where they are not known. The gap is measured
    along the triangle's normal, or from its edge where the point is far beyond it.
    """

    points: Any
    triangles: Any
    margin: Any
    rough: bool = static()
    around: Any = dataclasses.field(default=None, kw_only=True)
    beyond: float = static(default=ASIDE, kw_only=True)
    """Share of a triangle's size by which a point may be beyond the surface's edge and still be carried."""

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"{self.points.kind}-soft {self.triangles.shape[1]}"

    @property
    def give(self) -> float:
        """Nodes of two soft bodies meet each other's triangles: hardly aside of each other, they say the same twice."""
        return 0.0 if self.around is None else SAID_AGAIN

    def pairs(self, at: Configuration) -> Pairs:
        """The other side is a point of the triangle: the mean of its corners with barycentric weights."""
        placed = self.points.placed(at)
        outward = None if self.around is None else areas_around(at.nodes, self.around)
        chosen, weights, normal = nearest_triangle(placed.position, at.nodes, self.triangles, outward)
        gap, normal = gap_from(placed.position, weights, normal, at.nodes[chosen], self.beyond)
        return Pairs(gap, normal, difference(SoftPoint(chosen, weights).placed(at), placed))
