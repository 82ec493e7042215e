"""What the extra rows of a step bring to the semismooth solve: their terms, and bounds that follow normal impulses."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.methods.nodes.cone import sliding, width, wished_impulses
from jaxfem.rows.bounds import STILL, Bounds, Impulses, friction_radii, named, row_bounds, sides_of, turned
from jaxfem.solvers.row_terms import Blocks, RowTerms
from jaxfem.solvers.semismooth import Follow
from jaxfem.system.soft import System
from jaxfem.tensors import inner

Array = jax.Array
Sides = tuple[Array | None, ...]


def bounds_of(system: System, impulses: Impulses, wished: Impulses | None = None) -> Bounds:
    """Bounds of the extra rows at their `impulses`; with `wished`, those of pairs in a cone (see `friction_radii`)."""
    return row_bounds(system.extra, friction_radii(system.friction, impulses, wished))


def following(system: System) -> Follow | None:
    """(impulses, slack) -> bounds of the extra rows, which move with friction's normal impulses; None without any."""
    return _follower(system) if system.friction else None


def terms_at(system: System, velocities: Array, impulses: Impulses) -> RowTerms:
    """The extra rows' terms at `velocities` (n, 3) of all triples, to start from `impulses`; `local` is yet to come."""
    first = tuple(impulses.values())
    slack = tuple(rows.bias - rows.apply(velocities) for rows in system.extra.values())
    return _terms(tuple(system.extra.values()), slack, first, _follower(system)(first, slack))


def held_rows(system: System, impulses: Impulses) -> Blocks:
    """Masks of the extra rows that derivatives hold at a bound."""
    sides = sliding(system, impulses, sides_of(bounds_of(system, impulses), impulses))
    return tuple(side != 0 for side in sides.values())


def without_room(system: System, velocities: Array, impulses: Impulses, sides: Impulses) -> Impulses:
    """`sides` with friction rows of a pyramid that have no room `turned`; `velocities` (n, 3): of all triples."""
    if not system.friction:
        return sides
    moved = sides.copy()
    energy = inner(system.target, system.mass[:, None] * system.target)
    for name, each in system.friction.items():
        if not each.cone:
            rows, lam = system.extra[name], impulses[name]
            speed = jax.lax.stop_gradient(rows.apply(velocities) + rows.compliance * lam - rows.bias)
            still = jnp.abs(speed) <= STILL * system.tolerance * jnp.sqrt(width(system, rows) * energy)
            moved[name] = turned(sides[name], lam, speed, still)
    return moved


def tangent_terms(system: System, held: Blocks, right: Blocks) -> RowTerms:
    """The terms of a derivative, whose rows that are not `held` have no bounds; `right`: what they are to meet."""
    active, extra = tuple(~mask for mask in held), tuple(system.extra.values())
    slack = tuple(jnp.where(on, -r, 0) for on, r in zip(active, right, strict=True))
    none = (None,) * len(extra)
    return _terms(extra, slack, tuple(jnp.zeros_like(r) for r in slack), (none, none), active)


def _terms(extra: Any, slack: Any, start: Any, bounds: Any, active: Any = None) -> RowTerms:
    compliance = tuple(jnp.broadcast_to(rows.compliance, rows.bias.shape) for rows in extra)
    return RowTerms(slack, compliance, bounds[0], bounds[1], start, compliance, active or (None,) * len(extra))


def _follower(system: System) -> Follow:
    names, cones = tuple(system.extra), any(each.cone for each in system.friction.values())

    def follow(impulses: Blocks, slack: Blocks) -> tuple[Sides, Sides]:
        known = named(names, impulses)
        low, up = bounds_of(system, known, wished_impulses(system, known, slack) if cones else None)
        return tuple(low.values()), tuple(up.values())

    return follow
