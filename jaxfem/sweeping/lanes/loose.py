"""Bodies that nothing holds, and the momentum that they keep with lanes last: see `system/momentum.py`."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model
from jaxfem.pytrees import Pytree, on_device
from jaxfem.system import rigid_part
from jaxfem.system.rigid_part import arms, cross, inertia, spins

Array = jax.Array


class Loose(Pytree):
    """Which nodes and elements are whose: `nodes` (b, n) and `elements` (b, E + 1), 1 where they belong to a body, and
    `loose` (b, 1, 1): 1 for bodies that nothing holds."""

    nodes: Array
    elements: Array
    loose: Array

    def sums(self, values: Array) -> Array:
        """Sums over each body's (b, ..., lanes) of values (n, ..., lanes) of the nodes."""
        if len(self.nodes) == 1:
            return values.sum(0, keepdims=True)
        return jnp.stack([(row.reshape(-1, *(1,) * (values.ndim - 1)) * values).sum(0) for row in self.nodes])

    def spread(self, values: Array, points: int = 0) -> Array:
        """Each node's own of values (b, ..., lanes) of the bodies, (n, ..., lanes), or (1, ..., lanes) of one body."""
        return _spread(self.nodes, values)

    def of_elements(self, values: Array) -> Array:
        """Each element's own, (E + 1, ..., lanes)."""
        return _spread(self.elements, values)


def loose_of(model: Model, order: np.ndarray) -> Loose | None:
    """Of a model whose nodes stand in `order`; None where something holds each of its bodies."""
    if model.drifting is None:
        return None
    count, dtype = len(model.bodies), model.rest.dtype
    number = np.arange(count)[:, None]
    elements = np.asarray(model.elements.body)
    return Loose(
        on_device(np.asarray(model.node_body)[order] == number, dtype),
        on_device(np.append(elements, elements[:1]) == number, dtype),
        on_device(np.asarray(model.drifting.loose)[:count, None, None], dtype),
    )


def angles(of: Loose, mass: Array, places: Array, velocities: Array, dt: Array) -> Array:
    """Rotation vectors (b, 3, lanes) of each body's turn as a whole in a step, zero where something holds it."""
    return rigid_part.angles(of, mass, places, velocities, dt) * of.loose


def kept(of: Loose, mass: Array, places: Array, velocities: Array, defect: Array, straight: bool) -> Array:
    """Velocities (n, 3, lanes) with the momentum that free bodies keep; `defect` (n, 3, lanes): M (v - v*)."""
    change = of.spread(-of.sums(defect) / of.sums(mass) * of.loose)
    if straight:
        arm = arms(of, mass, places)
        spin = -spins(inertia(of, mass, arm), of.sums(cross(arm, defect))) * of.loose
        change = change + cross(of.spread(spin), arm)
    return velocities + change


def _spread(member: Array, values: Array) -> Array:
    if len(member) == 1:
        return values
    rows = [row.reshape(-1, *(1,) * (values.ndim - 1)) * value for row, value in zip(member, values, strict=True)]
    found: Array = sum(rows[1:], start=rows[0])
    return found
