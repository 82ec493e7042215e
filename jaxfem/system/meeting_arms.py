"""Rows with the arms that two bodies have when they are struck, so that an impact in a step keeps angular momentum.

A body that goes on for the share b of a step h before it is struck is then at x + b h v_old. An impulse P at the place
p turns it by (p - x - b h v_old) x P. With the arms of the step's start, two bodies that pass each other would gain
b h (v_1 - v_2) x P between them. The place p goes along with the mean of the two.
"""

from collections import OrderedDict
from collections.abc import Mapping

import jax
import jax.numpy as jnp

from jaxfem.rows.points import PointRows
from jaxfem.tensors import contract

Array = jax.Array

BETWEEN = 4
"""Triples of contact rows between two rigid bodies, each with a linear and an angular velocity."""


def with_arms_when_struck(
    extra: Mapping[str, PointRows], ways: Array, moving: Array, nodes: int
) -> OrderedDict[str, PointRows]:
    """All rows, those between two bodies that are `moving` (b,) with the arms that these have when they have gone their
    `ways` (b, 3) [m] until they are struck. `nodes`: how many triples come before the bodies'."""
    return OrderedDict((name, _moved(rows, ways, moving, nodes)) for name, rows in extra.items())


def _moved(rows: PointRows, ways: Array, moving: Array, nodes: int) -> PointRows:
    m, r, _ = rows.jacobian.shape
    width, count = rows.triples.shape[1], moving.shape[0]
    if width < BETWEEN:
        return rows
    parts = rows.jacobian.reshape(m, r, width, 3)
    body = rows.triples - nodes
    linear = (body >= 0) & (body < count)
    linear = linear & moving[jnp.where(linear, body, 0)]
    linear = linear & (jnp.sum(linear, axis=1, keepdims=True) == 2)
    own = ways[jnp.where(linear, body, 0)] * linear[:, :, None]
    gone = (own - jnp.sum(own, axis=1, keepdims=True) / 2) * linear[:, :, None]
    change = -jnp.cross(gone[:, None], parts)  # (m, r, k, 3), of the angular triple of the same body
    same = linear[:, :, None] & (rows.triples[:, :, None] + count == rows.triples[:, None])
    first = same & (jnp.cumsum(same, axis=2) == 1)  # the spin of a frame may stand there too
    parts = parts + contract("mrai,mab->mrbi", change, first.astype(parts.dtype))
    return rows.replace(jacobian=parts.reshape(m, r, -1))
