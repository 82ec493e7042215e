"""A few of many candidates: those that may be nearest, so that a step's rows do not grow with what is far away."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import static
from jaxfem.rows.attachments import Configuration
from jaxfem.rows.candidates import Pairs
from jaxfem.rows.contact import ShapeContacts

Array = jax.Array

MOST_POINTS = 32
"""Points of a body that take part in a step."""
TIE = 1e-6  # of the largest bound's size: what decides between those that are as near


def nearest(bounds: Array, most: int) -> Array:
    """Numbers (most,), in order, of the least of `bounds` (m,) on the gaps. Among equals it takes some from all over,
    so that a body does not stand on the first corners of a list."""
    bits = max(1, (len(bounds) - 1).bit_length())
    places = np.arange(len(bounds))
    spread = sum(((places >> k) & 1) << (bits - 1 - k) for k in range(bits)) / 2**bits
    scale = TIE * jnp.max(jnp.abs(bounds))
    return jnp.sort(jax.lax.top_k(-(bounds + scale * jnp.asarray(spread, bounds.dtype)), most)[1])


def chosen(candidates: Any, numbers: Array, **kept: Any) -> Any:
    """Those of the candidates, in their order; `kept`: fields that are not one for each of them."""
    fewer = jax.tree.map(lambda leaf: leaf[numbers], candidates.replace(**dict.fromkeys(kept)))
    return fewer.replace(**kept)


class NearbyContacts(ShapeContacts):
    """As `ShapeContacts`, of which `most` take part in a step, and `margin` (most,)."""

    most: int = static(kw_only=True)

    @property
    def kind(self) -> str:
        """Words for the kinds of partners."""
        return f"{super().kind} nearby"

    @property
    def alone(self) -> bool:
        """Its `most` candidates are one contact's."""
        return True

    def pairs(self, at: Configuration) -> Pairs:
        """Those of the points that are nearest."""
        fixed = jax.lax.stop_gradient((self, at))
        gaps = fixed[0]._distance(fixed[0].points.placed(fixed[1]).position, fixed[1])[0] - fixed[0].radius
        kept = {"margin": self.margin} | ({"shape": self.shape} if self.shared else {})
        few: NearbyContacts = chosen(self, nearest(gaps, self.most), **kept)
        return super(NearbyContacts, few).pairs(at)
