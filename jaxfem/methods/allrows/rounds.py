"""Friction's bounds at their fixed point: rows are solved with bounds from the last normal impulses until these settle.

That is a solution of the coupled problem (Haslinger's fixed point, 1983; not of the relaxed convex one). Redundant
contacts, as the four corners of a box, share what they carry by a trace of compliance alone, and their bounds may drift
or circle for ever: so after some rounds it also ends where friction put on its new bounds would move nothing any more.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import one_trace
from jaxfem.methods.allrows.condition import Found
from jaxfem.methods.allrows.operator import RowOperator, pushed
from jaxfem.rows.bounds import Bounds, Impulses, Radii, friction_radii, named, placed, row_bounds
from jaxfem.solvers import trees
from jaxfem.solvers.status import Status
from jaxfem.system.coupled import apply_inverse_mass
from jaxfem.system.soft import System

Array = jax.Array

FRICTION_ROUNDS = 100
PLAIN_ROUNDS = 8  # after these, bounds go half of the way only: where they circle, that brings them to rest
FRICTION_SLACK = 10.0  # bounds have settled when they change by no more than this times the tolerance


def with_friction(
    system: System,
    operator: RowOperator,
    guess: Impulses,
    once: Callable[[Impulses, Bounds, Array], Found],
    rounded: bool = False,
) -> Found:
    """`once(start, bounds, limit)`, repeated until friction's bounds fit; from some round on, halfway to them only.

    `limit`: the iterations that are left of the step's own limit, which counts those of all rounds. `rounded`: whether
    rounding may end a solve before the tolerance is met; impulses are then known to no more than its residual.
    """
    if not system.friction:
        return once(guess, row_bounds(system.rows, {}), system.max_iterations)
    once = one_trace(once)
    normals = {each.normal for each in system.friction.values()}

    def wanted(found: Impulses) -> Radii:
        return friction_radii(system.friction, found, _wished(system, operator, found))

    def change(found: Impulses, radii: Radii) -> Array:
        fresh = wanted(found)
        moved = sum(jnp.sum((fresh[name] - old) ** 2) for name, old in radii.items())
        size = sum(jnp.sum(found[name] ** 2) for name in sorted(normals))
        return jnp.sqrt(moved / jnp.where(size > 0, size, 1))

    def unsettled(found: Found, radii: Radii, rounds: Array) -> Array:
        moved = change(found.impulses, radii)
        known = jnp.maximum(system.tolerance, found.info.residual) if rounded else system.tolerance
        felt = _felt(system, operator, found, wanted(found.impulses)) > FRICTION_SLACK * known
        more: Array = (moved > FRICTION_SLACK * known) & (felt | (rounds < PLAIN_ROUNDS)) & (found.info.status == 0)
        return more

    def trip(carry: Any) -> Any:
        last, radii, _, rounds, total = carry
        fresh = wanted(last.impulses)
        part = jnp.where(rounds < PLAIN_ROUNDS, 1.0, 0.5).astype(system.target.dtype)
        radii = jax.tree.map(lambda old, new: old + part * (new - old), radii, fresh)
        bounds = row_bounds(system.rows, radii)
        # What was at a bound starts at the new one: left behind it would be let go, and all sides be sought anew.
        found = once(placed(bounds, last.sides, last.impulses), bounds, system.max_iterations - total)
        return found, radii, unsettled(found, radii, rounds), rounds + 1, total + found.info.iterations

    def running(carry: Any) -> Array:
        _, _, more, rounds, _ = carry
        further: Array = more & (rounds < FRICTION_ROUNDS)
        return further

    # Into the loop as if a round had been made, so that it is compiled once.
    radii, zero = wanted(guess), jnp.int32(0)
    shapes = jax.eval_shape(once, guess, row_bounds(system.rows, radii), system.max_iterations)
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes).replace(impulses=guess)
    start = (blank, radii, jnp.bool_(True), zero, zero)
    found, _, more, _, total = jax.lax.while_loop(running, trip, start)
    status = jnp.where(more, int(Status.ITERATION_LIMIT), found.info.status).astype(jnp.int32)
    ended: Found = found.replace(info=found.info.replace(iterations=total, status=status))
    return ended


def _felt(system: System, operator: RowOperator, found: Found, radii: Radii) -> Array:
    """How fast it would be moved by friction that is put on bounds at `radii`, over what all impulses move it by.

    In the measure of kinetic energy.
    """

    def speed(impulses: Impulses) -> Array:
        push = pushed(system, impulses)
        return jnp.sqrt(jnp.sum(push * apply_inverse_mass(operator.inverse, push)))

    bounds = row_bounds(system.rows, radii)
    on = placed(bounds, found.sides, found.impulses)
    change = trees.zeros(on)
    for name in system.friction:
        change[name] = jnp.clip(on[name], bounds[0][name], bounds[1][name]) - found.impulses[name]
    whole = speed(found.impulses)
    return speed(change) / jnp.where(whole > 0, whole, 1)


def _wished(system: System, operator: RowOperator, impulses: Impulses) -> Impulses | None:
    """Impulses less the residual over their diagonal; None where no friction is in a cone."""
    if not any(each.cone for each in system.friction.values()):
        return None
    residual = trees.minus(operator.apply(impulses), operator.right)
    wide = {name: jnp.max(each, -1, keepdims=True) for name, each in operator.diagonal.items()}
    return named(impulses, (lam - residual[name] / wide[name] for name, lam in impulses.items()))
