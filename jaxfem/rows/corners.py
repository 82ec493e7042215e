"""Corners of rigid bodies and of ground against the faces of soft ones, which nodes of the soft body alone do not see.

A soft body under a rigid one bulges: nodes at its rim slip out from under the rigid body's own rim, and what is left to
carry it may be a single node in the middle. The rigid body's corners then stand on the soft face.
"""

from typing import Any

import jax.numpy as jnp

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration, RigidPoint, SoftPoint, WorldPoint, difference
from jaxfem.rows.candidates import Candidates, Pairs
from jaxfem.rows.contact import SAID_AGAIN
from jaxfem.rows.triangles import aside, nearest_triangle
from jaxfem.tensors import contract

DEEPEST = 0.5
"""Share of a triangle's size down to which a corner beneath it has come through it: deeper, it is on another side."""

AT_NODE = 1e-3  # weight of a triangle's two other corners up to which the node there has the point
FAR = 1e3  # gap of what takes no part, in sizes of the triangle


class CornerContacts(Candidates):
    """Sharp points of solids against the surface of a soft body: each against the nearest triangle that faces it.

    `points` (m), of rigid bodies or of ground; `outward` (m, 3): a direction in each solid's frame in which it ends at
    the point: a triangle that looks the same way is of the soft body's other side; `triangles` (m, t, 3): nodes of
    those that each may meet.
    """

    points: RigidPoint | WorldPoint
    outward: Any
    triangles: Any
    margin: Any
    rough: bool = static()

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"{self.points.kind} corner-soft {self.triangles.shape[1]}"

    @property
    def give(self) -> float:
        """Nodes beneath the body and its corners on their triangles say nearly the same where it lies flat."""
        return SAID_AGAIN

    def pairs(self, at: Configuration) -> Pairs:
        """The other side is a point of the triangle; beyond its edge the gap is the way from there. On a node the two
        would say the same twice: the node's own row does."""
        placed = self.points.placed(at)
        outward = self.outward
        if isinstance(self.points, RigidPoint):
            outward = contract("mij,mj->mi", at.rotations[self.points.body], outward)
        chosen, weights, normal = nearest_triangle(placed.position, at.nodes, self.triangles, outward)
        other = SoftPoint(chosen, weights).placed(at)
        way, corners = placed.position - other.position, at.nodes[chosen]
        beyond, area = aside(way, normal, corners)
        height = jnp.sum(way * normal, -1)
        away = beyond | (jnp.sum(outward * normal, -1) >= 0) | (height < -DEEPEST * jnp.sqrt(area))
        apart = (away & jnp.any(way != 0, -1))[:, None]
        length = jnp.linalg.norm(jnp.where(apart, way, 1), axis=-1)
        normal = jnp.where(apart, way / length[:, None], normal)
        said = ~away & (jnp.max(weights, -1) > 1 - AT_NODE)
        gap = jnp.where(said, FAR * jnp.sqrt(area), jnp.where(away, length, height))
        return Pairs(gap, normal, difference(other, placed))
