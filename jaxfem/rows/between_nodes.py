"""Points on the surface edges of one soft body, between its nodes, against the surface of another.

Where a body is thinner than the other's nodes are apart, none of them need be over it, as of two bars that cross or of
two cubes that are turned on each other: edges would pass through edges. Points between the nodes close such gaps.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration, SoftPoint
from jaxfem.rows.candidates import Pairs
from jaxfem.rows.contact import SAID_AGAIN
from jaxfem.rows.patches import PAST
from jaxfem.rows.surfaces import SurfaceContacts
from jaxfem.tensors import contract

LEVEL = 1e-5
"""Of an edge's length: depth below what its ends say from which on a point between them has a row."""
FAR = 1e3  # gap of what takes no part, in lengths of the edge


class BetweenNodes(SurfaceContacts):
    """As `SurfaceContacts`, `points` being `SoftPoint`s of two nodes each."""

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"edges {super().kind}"

    @property
    def give(self) -> float:
        """Several points of an edge, and those of edges beside it, say nearly the same."""
        return SAID_AGAIN

    def pairs(self, at: Configuration) -> Pairs:
        """What an edge's ends say, their own rows do: a point takes part where it is deeper than they say there."""
        pairs = super().pairs(at)
        fixed, still = jax.lax.stop_gradient((self, at))
        ends = [self._end(fixed, still, k) for k in range(2)]
        spanned = contract("mk,mk->m", fixed.points.weights, jnp.stack(ends, 1))
        length = jnp.linalg.norm(jnp.diff(still.nodes[fixed.points.nodes], axis=1)[:, 0], axis=-1)
        own = jax.lax.stop_gradient(pairs.gap) < spanned - LEVEL * length
        return pairs.replace(gap=jnp.where(own, pairs.gap, FAR * length))

    @staticmethod
    def _end(fixed: Any, at: Configuration, k: int) -> jax.Array:
        """Gap (m,) of the edges' first or second node."""
        nodes = fixed.points.nodes[:, k : k + 1]
        ends = SoftPoint(nodes, jnp.ones(nodes.shape, fixed.margin.dtype))
        alone = SurfaceContacts(
            ends, fixed.triangles, fixed.margin, fixed.rough, around=fixed.around, beyond=fixed.beyond
        )
        return alone.pairs(at).gap


class PatchEdges(BetweenNodes):
    """The same of two patches of one body, `deep` (m,) [m] behind which points are elsewhere, as in `PatchContacts`."""

    deep: Any = dataclasses.field(default=None, kw_only=True)
    beyond: float = static(default=PAST, kw_only=True)

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"patches {super().kind}"

    def pairs(self, at: Configuration) -> Pairs:
        """As for two bodies."""
        pairs = super().pairs(at)
        return pairs.replace(gap=jnp.where(pairs.gap < -self.deep, jnp.abs(pairs.gap) + 2 * self.margin, pairs.gap))
