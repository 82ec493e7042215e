"""Resolved loads: what enters the compiled step. Each turns its value (a leaf of `params.loads`) into nodal forces."""

from collections.abc import Sequence
from typing import ClassVar, Protocol

import jax
import jax.numpy as jnp

from jaxfem.batching import one_program
from jaxfem.pytrees import Pytree

Array = jax.Array


class ResolvedLoad(Protocol):
    """A load as the step knows it, a Pytree: `params.loads` holds its value.

    `symmetric`: whether the derivative of its forces in the positions is symmetric, as that of dead loads, which have
    none, and of those with a potential. Others say False: derivatives of `equilibrium` are then solved for in general.
    """

    symmetric: ClassVar[bool]

    def force(self, value: Array, positions: Array) -> Array:
        """Nodal forces (n, 3) [N] of a value, at `positions` (n, 3)."""

    def reshaped(self, rest: Array) -> "ResolvedLoad":
        """The load on a body of other rest positions (n, 3) [m]; pure. Only `jf.rebuild` asks for it."""


class WeightedForce(Pytree):
    """Force on `nodes` (k,): `weights` (k,) times the value, (3,) or (k, 3). Dead: does not turn with the body.

    The weights are shares that stay when the rest shape changes: a material point's, or one a node.
    """

    symmetric: ClassVar[bool] = True

    nodes: Array
    weights: Array

    def force(self, value: Array, positions: Array) -> Array:
        """Nodal forces (n, 3) [N]."""
        return jnp.zeros_like(positions).at[self.nodes].add(self.weights[:, None] * value)

    def reshaped(self, rest: Array) -> "WeightedForce":
        """The same shares."""
        return self


class AreaForce(WeightedForce):
    """Force per undeformed area on faces: `nodes` (3 k,), their corners in turn, `weights` a third of each area."""

    def reshaped(self, rest: Array) -> "AreaForce":
        """The faces' new areas."""
        a, b, c = (rest[self.nodes.reshape(-1, 3)[:, i]] for i in range(3))
        area = 0.5 * jnp.linalg.norm(jnp.cross(b - a, c - a), axis=1)
        return self.replace(weights=jnp.repeat(area / 3, 3))


class FacePressure(Pytree):
    """Pressure against the outward normal of the deformed `faces` (k, 3), shared equally by their corners."""

    symmetric: ClassVar[bool] = False

    faces: Array

    def force(self, value: Array, positions: Array) -> Array:
        """Nodal forces (n, 3) [N]: -p (area vector) / 3 on each corner."""
        a, b, c = (positions[self.faces[:, i]] for i in range(3))
        area = 0.5 * jnp.cross(b - a, c - a)
        corner = jnp.broadcast_to((-value / 3 * area)[:, None], (*self.faces.shape, 3))
        return jnp.zeros_like(positions).at[self.faces].add(corner)

    def reshaped(self, rest: Array) -> "FacePressure":
        """The same: areas are those of the moment."""
        return self


@one_program
def load_force(loads: Sequence[ResolvedLoad], values: Sequence[Array], positions: Array) -> Array:
    """Sum of all resolved loads on the nodes, (n, 3) [N]."""
    total = jnp.zeros_like(positions)
    for load, value in zip(loads, values, strict=True):
        total = total + load.force(value, positions)
    return total
