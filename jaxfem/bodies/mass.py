"""Mass matrices of linear tetrahedra: lumped on the nodes, consistent with the shape functions, and their mean."""

from typing import Literal

import jax
import jax.numpy as jnp

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
