"""The impulses of all rows by elimination: an active set, and on the rows in play a factorised matrix.

The rows found at a bound are held there, the others solved for exactly; then rows outside their bounds are put on them,
and those that are held against their will let go (primal-dual active set: Hintermueller, Ito & Kunisch 2002). That ends
after a few rounds, but may circle where rows are redundant. Then of the rows that want it the first changes sides
alone, until fewer want to than ever before (block principal pivoting: Judice & Pires 1994). Where that takes too many
rounds, MPRGP goes on from the best point within the bounds, which is no worse than the start.

Velocities are carried along, v = v* + M^-1 J' lam: a residual c - J v - C lam measured on *them* knows no rounding of
large impulses that cancel, only that of the last corrections. Single precision reaches 1e-5 so, where tension is great.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.methods.allrows.factor import row_preconditioner
from jaxfem.methods.allrows.operator import RowOperator, pushed
from jaxfem.methods.allrows.order import RowOrder
from jaxfem.pytrees import Pytree
from jaxfem.rows.bounds import Bounds, Impulses, named, placed, sides_of
from jaxfem.solvers import trees
from jaxfem.solvers.box import make_box
from jaxfem.solvers.mprgp import mprgp_loop
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.coupled import apply_inverse_mass, apply_mass
from jaxfem.system.soft import System, inverse_mass

Array = jax.Array

ROUNDS = 150
PATIENT = 5  # rounds in which no fewer rows than ever want to change sides, after which only one does
REFINEMENTS = 30
SLACK = 0.1  # of the tolerance: how far a row may be out of its bounds, or pull on them, without a change of sides
ROUNDING = 4.0  # times the precision times the size of the velocities: a residual with nothing but rounding in it


class _Found(Pytree):
    """Impulses, the velocities that they give, and the residual c - J v - C lam of all rows."""

    impulses: Impulses
    velocities: Array
    residual: Impulses


class _Round(Pytree):
    found: _Found
    sides: Impulses
    best: _Found  # of those within the bounds the one with the least energy
    size: Array
    changed: Array
    fewest: Array  # rows that wanted to change sides in a round
    patience: Array
    rounds: Array
    products: Array


def search_by_elimination(
    system: System, order: RowOrder, guess: Impulses, operator: RowOperator, bounds: Bounds, most: Array
) -> tuple[Impulses, Array, SolveInfo]:
    """Impulses within `bounds`, the velocities that they give, and info; its iterations are products with A, of
    which there are no more than `most`, but for the last round's check."""
    right, diagonal, inverse = operator.right, operator.diagonal, operator.inverse
    root = jax.tree.map(jnp.sqrt, diagonal)
    scale, wanted = _sizes(system, right, root)
    slack = jax.tree.map(lambda r: SLACK * wanted / (r * trees.size(guess) ** 0.5), root)
    bounded = any(low is not None for low in bounds[0].values())

    def at(impulses: Impulses) -> _Found:
        return _measured(system, impulses, system.target + apply_inverse_mass(inverse, pushed(system, impulses)))

    def trip(last: _Round) -> _Round:
        start = placed(bounds, last.sides, last.found.impulses)
        left = most - last.products
        limit = jnp.minimum(REFINEMENTS, left) if bounded else left
        found, size, products = _refined(system, order, at(start), last.sides, diagonal, wanted, limit)
        sides = _judged(found, diagonal, last.sides, slack, bounds)
        pairs = zip(jax.tree.leaves(sides), jax.tree.leaves(last.sides), strict=True)
        count = sum((jnp.sum(a != b, dtype=jnp.int32) for a, b in pairs), start=jnp.int32(0))
        changed = (count > 0) & bounded
        patience = jnp.where(count < last.fewest, PATIENT, last.patience - 1)
        sides = trees.where(patience > 0, sides, _first_changed(sides, last.sides))
        best = _lower(system, inverse, last.best, found, bounds)
        fewest, made = jnp.minimum(last.fewest, count), last.products + products + 2
        return _Round(found, sides, best, size, changed, fewest, patience, last.rounds + 1, made)

    def running(s: _Round) -> Array:
        more: Array = s.changed & (s.rounds < ROUNDS) & (s.products < most)
        return more

    zero = jnp.int32(0)
    nothing = _Found(guess, system.target, right)
    counts = jnp.int32(trees.size(guess) + 1), jnp.int32(PATIENT), zero, zero
    first = _Round(nothing, sides_of(bounds, guess), at(_clipped(guess, bounds)), scale, jnp.bool_(True), *counts)
    end = jax.lax.while_loop(running, trip, first) if bounded else trip(first)
    impulses = _clipped(end.found.impulses, bounds)
    change = trees.minus(impulses, end.found.impulses)
    velocities = end.found.velocities + apply_inverse_mass(inverse, pushed(system, change))
    relative = end.size / jnp.where(scale > 0, scale, 1)
    info = SolveInfo(_status(end, wanted), end.products, relative, _weak(end, impulses, root, bounds, wanted))
    if not bounded:
        return impulses, velocities, info

    def go_on() -> tuple[Impulses, Array, SolveInfo]:
        stop = {"tol": wanted / jnp.where(scale > 0, scale, 1)}
        stop["max_iterations"] = jnp.where(info.status == 0, 0, most - end.products)
        further, after = mprgp_loop(operator.apply, right, *bounds, x0=end.best.impulses, diagonal=diagonal, **stop)
        return further, at(further).velocities, after.replace(iterations=after.iterations + end.products)

    found: tuple[Impulses, Array, SolveInfo] = jax.lax.cond(
        info.status == 0, lambda: (impulses, velocities, info), go_on
    )
    return found


def _sizes(system: System, right: Impulses, root: Impulses) -> tuple[Array, Array]:
    """The right side's size in scaled variables, and that of the residual to reach."""
    scale = trees.norm(jax.tree.map(jnp.divide, right, root))
    # What a step cannot do better than: the rounding of velocities as large as those in it.
    energy = jnp.sum(system.target * apply_mass(system, system.target))
    floor = ROUNDING * jnp.finfo(scale.dtype).eps * jnp.sqrt(energy)
    return scale, jnp.maximum(system.tolerance * scale, floor)


def _status(end: _Round, wanted: Array) -> Array:
    good = jnp.where((end.size <= wanted) & ~end.changed, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
    return jnp.where(jnp.isfinite(end.size), good, int(Status.NOT_FINITE)).astype(jnp.int32)


def _weak(end: _Round, impulses: Impulses, root: Impulses, bounds: Bounds, wanted: Array) -> Array:
    """Rows at a bound with no force against it, in scaled variables."""
    box = make_box(impulses, *bounds).divided(jax.tree.map(lambda r: 1 / r, root))
    gradient = jax.tree.map(jnp.divide, end.found.residual, root)
    return box.weak(trees.times(root, impulses), gradient, 10 * wanted)


def _measured(system: System, impulses: Impulses, velocities: Array) -> _Found:
    rows = system.rows
    residual = named(
        rows, (each.bias - each.apply(velocities) - each.compliance * impulses[n] for n, each in rows.items())
    )
    return _Found(impulses, velocities, residual)


def _refined(
    system: System, order: RowOrder, found: _Found, sides: Impulses, diagonal: Impulses, wanted: Array, limit: Array
) -> tuple[_Found, Array, Array]:
    """A lam = b on the rows between their bounds: what is found, the residual's size there, and how many products.

    Conjugate gradients with residuals measured anew and the directions' own product (Golub & Ye 1999), preconditioned
    by the factor: one trip where that is exact.
    """
    inside = jax.tree.map(lambda side, d: (side == 0).astype(d.dtype), sides, diagonal)
    scale = jax.tree.map(lambda d, f: f * d**-0.5, diagonal, inside)
    precondition, inverse = row_preconditioner(system, order, diagonal, inside), inverse_mass(system)

    def running(carry: Any) -> Array:
        _, residual, _, _, trips = carry
        more: Array = (trees.norm(residual) > wanted) & (trips < limit)
        return more

    def trip(carry: Any) -> Any:
        found, residual, before, direction, trips = carry
        z = precondition(residual)
        old, new = trees.dot(before, direction), trees.dot(trees.minus(residual, before), z)
        beta = jnp.where((trips > 0) & (old > 0), jnp.maximum(new, 0) / jnp.where(old > 0, old, 1), 0)
        direction = trees.plus(z, beta, direction)
        change = trees.times(scale, direction)
        push = pushed(system, change)
        moved = apply_inverse_mass(inverse, push)
        soft = sum(jnp.sum(rows.compliance * change[name] ** 2) for name, rows in system.rows.items())
        curvature = jnp.sum(push * moved) + soft
        alpha = jnp.where(curvature > 0, trees.dot(residual, direction) / jnp.where(curvature > 0, curvature, 1), 0)
        here = _measured(system, trees.plus(found.impulses, alpha, change), found.velocities + alpha * moved)
        return here, trees.times(scale, here.residual), residual, direction, trips + 1

    first = trees.times(scale, found.residual)
    found, residual, _, _, trips = jax.lax.while_loop(
        running, trip, (found, first, first, trees.zeros(first), jnp.int32(0))
    )
    return found, trees.norm(residual), trips


def _lower(system: System, inverse: Any, best: _Found, found: _Found, bounds: Bounds) -> _Found:
    """What was found, put into the bounds, where its energy 1/2 lam' A lam - b' lam is less than that of the best."""
    there = _clipped(found.impulses, bounds)
    push = pushed(system, trees.minus(there, found.impulses))
    here = _measured(system, there, found.velocities + apply_inverse_mass(inverse, push))
    step = trees.minus(there, best.impulses)
    # The energy is quadratic, and its slope less the residual: what it falls by is known without cancellation.
    fall = trees.dot(best.residual, step) + trees.dot(here.residual, step)
    return trees.where(fall > 0, here, best)


def _first_changed(sides: Impulses, old: Impulses) -> Impulses:
    """The old sides, but for the first row of those whose side is another."""
    flat, before = (jnp.concatenate([each.reshape(-1) for each in tree.values()]) for tree in (sides, old))
    first = jnp.arange(flat.size) == jnp.argmax(flat != before)
    flat, parts, at = jnp.where(first, flat, before), [], 0
    for each in sides.values():
        parts.append(flat[at : at + each.size].reshape(each.shape))
        at += each.size
    return named(sides, parts)


def _clipped(impulses: Impulses, bounds: Bounds) -> Impulses:
    def clipped(name: str) -> Array:
        low, up = bounds[0][name], bounds[1][name]
        return impulses[name] if low is None or up is None else jnp.clip(impulses[name], low, up)

    return named(impulses, map(clipped, impulses))


def _side(lam: Array, low: Array, up: Array, slack: Any) -> Array:
    outside = jnp.where(lam <= low - slack, -1, jnp.where(lam >= up + slack, 1, 0))
    return jnp.where(low >= up, -1, outside).astype(jnp.int32)


def _judged(found: _Found, diagonal: Impulses, sides: Impulses, slack: Impulses, bounds: Bounds) -> Impulses:
    """Sides for the next round: where the impulse found, or a step along the residual of the rows held, leads outside.

    A held row stays unless its residual points inwards by more than the slack.
    """

    def judged(name: str) -> Array:
        lam, side, low, up, s = found.impulses[name], sides[name], bounds[0][name], bounds[1][name], slack[name]
        if low is None or up is None:
            return side
        stepped = lam + found.residual[name] / diagonal[name]
        return jnp.where(side == 0, _side(lam, low, up, s), _side(stepped, low, up, -s))

    return named(sides, map(judged, sides))
