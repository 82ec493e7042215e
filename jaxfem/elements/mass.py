"""Mass matrices of linear tetrahedra: lumped on the nodes, consistent with the shape functions, and their mean."""

from typing import Literal

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree

Array = jax.Array
MassKind = Literal["lumped", "consistent", "averaged"]

MASSES = ("lumped", "consistent", "averaged")
"""Lumped masses make modes slow, consistent ones make them fast, both in second order; the mean cancels much of it
(Goudreau & Taylor 1973)."""


def mass_product(kind: MassKind, lumped: Array, element_mass: Array, cells: Array, vector: Array) -> Array:
    """M times a nodal field (n, 3).

    `lumped` (n,) and `element_mass` (E,) [kg]; `cells` (E, 4). The consistent block of corners a and b of an element
    of mass m is m/20 (1 + [a = b]).
    """
    if kind == "lumped":
        return lumped[:, None] * vector
    # The [a = b] part sums to a fifth of the lumped mass.
    sums = element_mass[:, None] / 20 * jnp.sum(vector[cells], axis=1)
    consistent = (lumped[:, None] / 5 * vector).at[cells].add(sums[:, None])
    return consistent if kind == "consistent" else 0.5 * (consistent + lumped[:, None] * vector)


class SharedMass(Pytree):
    """What consistent or averaged masses add to lumped ones: they tie the corners of each element together.

    `element_mass` (E,) [kg], times the share that is consistent; `cells` (E, 4); `pairs` (6, E): where the blocks of an
    element's pairs of corners stand among all pairs of nodes.
    """

    element_mass: Array
    cells: Array
    pairs: Array

    def apply(self, vector: Array) -> Array:
        """(M - lumped M) times (n, 3): m/20 times the sum over an element's corners b of v_b - v_a."""
        corners = vector[self.cells]
        spread = jnp.sum(corners, axis=1, keepdims=True) - 4 * corners
        return jnp.zeros_like(vector).at[self.cells].add(self.element_mass[:, None, None] / 20 * spread)

    def blocks(self, count: int) -> Array:
        """Blocks of the `count` pairs of nodes, (count, 3, 3); a node's own is minus the sum of its row."""
        each = jnp.broadcast_to(self.element_mass / 20, self.pairs.shape)
        sums = jnp.zeros(count, each.dtype).at[self.pairs].add(each)
        return sums[:, None, None] * jnp.eye(3, dtype=sums.dtype)


def is_diagonal(kind: MassKind) -> bool:
    """Whether the mass matrix ties no two nodes together."""
    return consistent_share(kind) == 0


def consistent_share(kind: MassKind) -> float:
    """How much of the mass matrix is consistent."""
    return {"lumped": 0.0, "averaged": 0.5, "consistent": 1.0}[kind]
