"""Vertices of a surface that is finer than its mesh: a few near each node take part in a step, not one and all.

The vertices near a node of the mesh move almost as one. Rows for all of them say the same many times over, and what
they disagree on would have to be made of large impulses that cancel.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration
from jaxfem.rows.candidates import Candidates, Pairs
from jaxfem.rows.contact import DEEP, ShapeContacts
from jaxfem.rows.nearby import chosen

Array = jax.Array
GIVE = 1e-3
"""Of what a unit impulse moves a point's nodes by: how far it gives."""
FAR = 1e3
"""Margins: the gap of places in the table that hold no vertex."""


class ThinnedContacts(Candidates):
    """Of the candidates `every` (m), one kind of those of `contact.py`, the `most` with the least gaps in each row of
    `table` (k, w), numbers of candidates, -1 on padding; `margin` (k most,)."""

    every: Any
    table: Any
    margin: Any
    rough: bool = static()
    most: int = static()

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"{self.every.kind} thinned"

    @property
    def alone(self) -> bool:
        """Its table is one contact's."""
        return True

    @property
    def give(self) -> float:
        """Vertices near each other say nearly the same: what they do not share would be made of huge impulses."""
        return GIVE

    @property
    def points(self) -> Any:
        """All of the points, for a look."""
        return self.every.points

    def pairs(self, at: Configuration) -> Pairs:
        """Those with the least gaps. Of gaps that differ by less than what counts as touching the first ones are taken:
        what rests stays on the same vertices."""
        fixed = jax.lax.stop_gradient((self.every, at))
        margin = jax.lax.stop_gradient(self.margin[0])
        level = jnp.floor(fixed[0].pairs(fixed[1]).gap / (DEEP * margin))
        there = jnp.where(self.table >= 0, level[self.table], jnp.inf)
        spots = jnp.sort(jax.lax.top_k(-there, self.most)[1], axis=1)  # in order: a place keeps its impulse
        numbers = jnp.take_along_axis(self.table, spots, axis=1).ravel()
        kept = {"shape": self.every.shape} if isinstance(self.every, ShapeContacts) and self.every.shared else {}
        pairs: Pairs = chosen(self.every, jnp.maximum(numbers, 0), **kept).pairs(at)
        return pairs.replace(gap=jnp.where(numbers >= 0, pairs.gap, FAR * self.margin))


def thinned(candidates: Any, most: int) -> Any:
    """The candidates, thinned to `most` a node where that leaves fewer; host side.

    Each goes with the node of the largest weight of its point.
    """
    nodes, weights = np.asarray(candidates.points.nodes), np.asarray(candidates.points.weights)
    heaviest = np.take_along_axis(nodes, np.argmax(weights, axis=1)[:, None], axis=1)[:, 0]
    order = np.argsort(heaviest, kind="stable")
    starts = np.flatnonzero(np.diff(heaviest[order], prepend=-1))
    counts = np.diff(starts, append=len(order))
    if len(starts) * most >= len(order):
        return candidates
    rank = np.arange(len(order)) - np.repeat(starts, counts)
    table = np.full((len(starts), max(most, int(counts.max()))), -1)
    table[np.repeat(np.arange(len(starts)), counts), rank] = order
    margin = np.full(len(starts) * most, candidates.margin[0])
    return ThinnedContacts(candidates, table, margin, candidates.rough, most)
