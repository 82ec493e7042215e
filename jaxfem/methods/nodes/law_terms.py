"""What laws that are not linear put into the condensed matrix: blocks g_a C g_b of their tangents, or factors."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import Domains
from jaxfem.elements.finite import Curvature
from jaxfem.elements.pattern import Pattern
from jaxfem.indexing import scatter_add
from jaxfem.methods.nodes.factors import Bend, Factor, domain_factor
from jaxfem.methods.nodes.pairs import firsts, seconds

Array = jax.Array

_AXES = range(3)


def law_sums(domains: Domains, found: Curvature, reach: Any, pattern: Pattern, number: int) -> Array:
    """Blocks of all pairs of nodes (P, 3, 3): K_ab[i, k] = reach^2 sum over J, L of C[iJ, kL] g_a[J] g_b[L]."""
    assert found.whole is not None
    slots, g = pattern.pairs[number], domains.gradients
    tangent = (reach**2 * found.whole).reshape(3, 3, 3, 3, -1)
    # For the second node first: 27 numbers a domain and node, then three products a pair and entry.
    parts = [tangent[None, :, :, :, j] * g[:, None, None, None, j] for j in _AXES]
    along = (parts[0] + parts[1] + parts[2]).reshape(len(g), 27, -1)
    a, b = firsts(g, slots), seconds(along, slots)
    block = [a[0] * b[n] + a[1] * b[n + 3] + a[2] * b[n + 6] for n in (9 * i + k for i in _AXES for k in _AXES)]
    where = jnp.concatenate([each.reshape(-1) for each in slots])
    sums = scatter_add(jnp.stack(block, -1), where, pattern.pair_count)
    return sums.reshape(-1, 3, 3)


def law_factor(domains: Domains, found: Curvature, reach: Any, free: Array, pattern: Pattern, number: int) -> Factor:
    """The factor of volumetric domains: r_a = theta's slope times grad N_a; and what theta's curvature adds."""
    weight = reach**2 * found.weight
    factor = domain_factor(arms_of(domains, found), weight, free, pattern, number)
    if found.bend is None:
        return factor
    plain = domain_factor(domains.gradients, weight, free, pattern, number)
    return factor.replace(bend=Bend(plain.rows, plain.columns, jnp.moveaxis(reach**2 * found.bend, -1, 0)))


def arms_of(domains: Domains, found: Curvature) -> Array:
    """r_a, (m, 3, D)."""
    assert found.slope is not None
    g = domains.gradients
    return sum((found.slope[None, :, j] * g[:, None, j] for j in (1, 2)), start=found.slope[None, :, 0] * g[:, None, 0])
