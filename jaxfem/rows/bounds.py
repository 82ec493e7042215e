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
    """A group of tangential rows (m, 2) is bounded by `coefficient` (m,) times the impulses of the `normal` group.

    `cone`: the length of each pair is, else each row alone: a pyramid, which holds more along its diagonals.
    """

    coefficient: Array
    normal: str = static()
    cone: bool = static(default=False)


BEYOND = 1.01
"""Times the cone's radius: friction that is longer counts as beyond it."""


def beyond_cone(friction: Mapping[str, Friction], impulses: Mapping[str, Array]) -> Array | None:
    """How many pairs are longer than the cone allows, as a pyramid's are along its diagonals; None without pyramids."""
    pyramids = {name: each for name, each in friction.items() if not each.cone and name in impulses}
    if not pyramids:
        return None
    radii = friction_radii(pyramids, impulses)
    over = (jnp.linalg.norm(impulses[name], axis=-1) > BEYOND * radii[name][:, 0] for name in pyramids)
    return jnp.stack([jnp.sum(each) for each in over]).sum()


def named(names: Iterable[str], values: Iterable[Any]) -> OrderedDict[str, Any]:
    """Values by the names of their groups."""
    return OrderedDict(zip(names, values, strict=True))


def friction_radii(
    friction: Mapping[str, Friction], impulses: Mapping[str, Array], wished: Mapping[str, Array] | None = None
) -> Radii:
    """mu lam_n of each pair of friction rows (m, 1), from the normal impulses given.

    With `wished`, what pairs in a cone would be if nothing bounded them, theirs are the halves (m, 2) of a rectangle.
    """
    radii = {}
    for name, each in friction.items():
        # The coefficient outside: where it is 0, the radius still grows with it by all of the normal impulse.
        radius = each.coefficient[:, None] * jnp.maximum(impulses[each.normal], 0)
        radii[name] = inscribed(radius, wished[name]) if each.cone and wished is not None else radius
    return radii


def inscribed(radius: Array, wished: Array) -> Array:
    """Halves (m, 2) of the sides of rectangles in discs of `radius` (m, 1): the one that has what is wished (m, 2), cut
    off at the disc, on its border or is as near to a square as it can be.

    Rows bounded so hold no more than the cone, and where the bounds have settled they are its own: a pair that slides
    is at a corner of the rectangle, with the slip straight against it.
    """
    size = jnp.abs(wished)
    length = jnp.linalg.norm(size, axis=-1, keepdims=True)
    size = jnp.where(length > radius, size * radius / jnp.where(length > 0, length, 1), size)
    other = jnp.sqrt(jnp.maximum(radius**2 - size[:, ::-1] ** 2, 0))
    half = radius * jnp.sqrt(jnp.asarray(0.5, radius.dtype))
    first = jnp.where(size > half, size, jnp.where(size[:, ::-1] > half, other, half))
    return first


def into_disc(pairs: Array, radius: Array) -> Array:
    """Pairs (m, 2) no longer than `radius` (m,)."""
    square = jnp.sum(pairs**2, -1)
    outside = square > radius**2
    length = jnp.sqrt(jnp.where(outside, square, 1))
    return jnp.where(outside, radius / length, 1)[:, None] * pairs


def without_cones(friction: Mapping[str, Friction], sides: Mapping[str, Array]) -> Impulses:
    """`sides` with pairs in a cone at none: where they slide is a matter of both rows."""
    cones = {name for name, each in friction.items() if each.cone}
    return named(sides, (0 * side if name in cones else side for name, side in sides.items()))


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


HELD = 2
"""A side: the impulse neither follows a bound nor moves freely between them."""


STILL = 10.0
"""Times the tolerance: what slides no faster, in the measure of residuals, does not slide."""


def turned(sides: Array, impulses: Array, speed: Array, still: Array) -> Array:
    """Sides of friction rows with those that have no room between their bounds at the one against their way.

    `still`: which of them do not move; they are held. So a coefficient of 0 has the derivative of what slides.
    """
    bare = (impulses == 0) & (sides != 0)
    against = jnp.where(still, HELD, jnp.where(speed > 0, -1, 1))
    return jnp.where(bare, against, sides).astype(sides.dtype)


def sides_of(bounds: Bounds, impulses: Mapping[str, Array]) -> Impulses:
    """-1 where an impulse is at or below its lower bound or between equal ones, 1 at its upper, 0 between."""

    def side(low: Array | None, up: Array | None, lam: Array) -> Array:
        if low is None or up is None:
            return jnp.zeros(lam.shape, jnp.int32)
        return jnp.where(lam <= low, -1, jnp.where(lam >= up, 1, 0)).astype(jnp.int32)

    return named(impulses, (side(bounds[0][name], bounds[1][name], lam) for name, lam in impulses.items()))


def placed(bounds: Bounds, sides: Mapping[str, Array], impulses: Mapping[str, Array]) -> Impulses:
    """Impulses with those at a bound (`sides` -1 or 1) put on it; others, and what is `HELD`, stay."""
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
    kept = jnp.where(sides[name] == HELD, jax.lax.stop_gradient(impulse), impulse)
    return jnp.where(sides[name] < 0, low, jnp.where(sides[name] == 1, up, kept))
