"""A soft body that touches itself: the nodes of two patches of its surface, each against the other's triangles."""

import dataclasses
from typing import Any

import jax.numpy as jnp

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration
from jaxfem.rows.candidates import Pairs
from jaxfem.rows.contact import SAID_AGAIN
from jaxfem.rows.surfaces import SurfaceContacts

SUNK = 0.25
"""Of the depth behind which nodes are elsewhere: those between the two are coming through."""
PAST = 0.1
"""Of a triangle's size: a patch ends where the user ended it, or where coarse arms are one triangle wide."""


class PatchContacts(SurfaceContacts):
    """Nodes of a patch of a soft body's surface against another patch of it, `deep` (m,) [m] behind which they are
    elsewhere: on the far side of what the patch bounds."""

    deep: Any = dataclasses.field(default=None, kw_only=True)
    beyond: float = static(default=PAST, kw_only=True)

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"patches {super().kind}"

    @property
    def give(self) -> float:
        """Nodes of both sides meet the other's triangles, so rows say nearly the same twice."""
        return SAID_AGAIN

    @property
    def deepest(self) -> Any:
        """A share of where they are taken to be elsewhere."""
        return SUNK * self.deep

    def pairs(self, at: Configuration) -> Pairs:
        """As for two bodies."""
        pairs = super().pairs(at)
        return pairs.replace(gap=jnp.where(pairs.gap < -self.deep, jnp.abs(pairs.gap) + 2 * self.margin, pairs.gap))
