"""Bounds of the rows that are not elastic, where friction ties some to the impulses of others."""

import jax
import jax.numpy as jnp

from jaxfem.system.soft import System, extra_rows

Array = jax.Array
Impulses = tuple[Array, ...]
Bounds = tuple[tuple[Array | None, ...], tuple[Array | None, ...]]


def extra_bounds(system: System, impulses: Impulses) -> Bounds:
    """Lower and upper bounds (None without) of the extra rows at their `impulses`.

    Friction rows have h = -l = mu lam_n with lam_n of the normal row beside them.
    """
    extra = extra_rows(system)
    skipped = len(system.rows) - len(extra)
    pairs = [(None, None) if rows.bounds is None else rows.bounds for rows in extra]
    for each in system.friction:
        normal = impulses[each.normal - skipped]
        radius = jnp.broadcast_to(jnp.maximum(each.coefficient[:, None] * normal, 0), (normal.shape[0], 2))
        pairs[each.tangent - skipped] = (-radius, radius)
    return tuple(low for low, _ in pairs), tuple(up for _, up in pairs)


def placed_at_bounds(system: System, sides: Impulses, impulses: Impulses) -> Impulses:
    """Impulses with those at a bound (`sides` -1 or 1) put on it, friction's own following the normal impulses put so.

    Differentiable: what is at a friction bound moves with its normal impulse and the coefficient.
    """
    extra = extra_rows(system)
    own = [(None, None) if rows.bounds is None else rows.bounds for rows in extra]
    settled = tuple(_placed(*each) for each in zip(sides, impulses, *zip(*own, strict=True), strict=True))
    if not system.friction:
        return settled
    tangent = {each.tangent - (len(system.rows) - len(extra)) for each in system.friction}
    low, up = extra_bounds(system, settled)
    return tuple(
        _placed(sides[i], impulses[i], low[i], up[i]) if i in tangent else settled[i] for i in range(len(extra))
    )


def sides_of(bounds: Bounds, impulses: Impulses) -> Impulses:
    """-1 where an impulse is at its lower bound or between equal ones, 1 at its upper, 0 between."""

    def side(low: Array | None, up: Array | None, lam: Array) -> Array:
        if low is None or up is None:
            return jnp.zeros(lam.shape, jnp.int32)
        return jnp.where(lam <= low, -1, jnp.where(lam >= up, 1, 0)).astype(jnp.int32)

    return tuple(side(*each) for each in zip(*bounds, impulses, strict=True))


def _placed(side: Array, impulse: Array, low: Array | None, up: Array | None) -> Array:
    if low is None or up is None:
        return impulse
    return jnp.where(side < 0, low, jnp.where(side > 0, up, impulse))
