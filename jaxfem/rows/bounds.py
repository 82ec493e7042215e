"""Boxes of rows, group by group: their own bounds, friction's that move with normal impulses, and sides of them.

Groups of rows, their impulses and what belongs to them are ordered dictionaries by the groups' names.
"""

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree, static
from jaxfem.rows.base import Rows

Array = jax.Array
Impulses = OrderedDict[str, Array]
Radii = dict[str, Array]
Bounds = tuple[OrderedDict[str, Array | None], OrderedDict[str, Array | None]]


class Friction(Pytree):
    """A group of tangential rows (m, 2) is bounded by `coefficient` (m,) times the impulses of the `normal` group."""

    coefficient: Array
    normal: str = static()


def named(names: Iterable[str], values: Iterable[Any]) -> OrderedDict[str, Any]:
    """Values by the names of their groups."""
    return OrderedDict(zip(names, values, strict=True))


def friction_radii(friction: Mapping[str, Friction], impulses: Mapping[str, Array]) -> Radii:
    """mu lam_n of each pair of friction rows (m, 1), from the normal impulses given."""
    return {name: jnp.maximum(each.coefficient[:, None] * impulses[each.normal], 0) for name, each in friction.items()}


def row_bounds(rows: Mapping[str, Rows], radii: Mapping[str, Array]) -> Bounds:
    """Lower and upper bounds of groups of rows (None without), those of friction rows at the radii given."""
    pairs: list[tuple[Array | None, Array | None]] = []
    for name, each in rows.items():
        if name in radii:
            wide = jnp.broadcast_to(radii[name], each.bias.shape)
            pairs.append((-wide, wide))
        else:
            pairs.append((None, None) if each.bounds is None else each.bounds)
    return named(rows, (low for low, _ in pairs)), named(rows, (up for _, up in pairs))


def sides_of(bounds: Bounds, impulses: Mapping[str, Array]) -> Impulses:
    """-1 where an impulse is at or below its lower bound or between equal ones, 1 at its upper, 0 between."""

    def side(low: Array | None, up: Array | None, lam: Array) -> Array:
        if low is None or up is None:
            return jnp.zeros(lam.shape, jnp.int32)
        return jnp.where(lam <= low, -1, jnp.where(lam >= up, 1, 0)).astype(jnp.int32)

    return named(impulses, (side(bounds[0][name], bounds[1][name], lam) for name, lam in impulses.items()))


def placed(bounds: Bounds, sides: Mapping[str, Array], impulses: Mapping[str, Array]) -> Impulses:
    """Impulses with those at a bound (`sides` -1 or 1) put on it."""
    return named(impulses, (_placed(name, bounds, sides, lam) for name, lam in impulses.items()))


def placed_at_bounds(
    rows: Mapping[str, Rows],
    friction: Mapping[str, Friction],
    sides: Mapping[str, Array],
    impulses: Mapping[str, Array],
) -> Impulses:
    """`placed`, friction's own bounds following the normal impulses that are put so.

    Differentiable: what is at a friction bound moves with its normal impulse and the coefficient.
    """
    settled = placed(row_bounds(rows, {}), sides, impulses)
    if not friction:
        return settled
    moving = row_bounds(rows, friction_radii(friction, settled))
    for name in friction:
        settled[name] = _placed(name, moving, sides, impulses[name])
    return settled


def _placed(name: str, bounds: Bounds, sides: Mapping[str, Array], impulse: Array) -> Array:
    low, up = bounds[0][name], bounds[1][name]
    if low is None or up is None:
        return impulse
    return jnp.where(sides[name] < 0, low, jnp.where(sides[name] > 0, up, impulse))
