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
from jaxfem.methods.allrows.flat import FlatBounds, FlatRows, flat, flat_bounds
from jaxfem.methods.allrows.order import RowOrder
from jaxfem.pytrees import Pytree
from jaxfem.rows.bounds import Bounds, Impulses, sides_of
from jaxfem.solvers import trees
from jaxfem.solvers.box import make_box
from jaxfem.solvers.mprgp import mprgp_loop
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.coupled import apply_inverse_mass, apply_mass
from jaxfem.system.soft import System

Array = jax.Array

ROUNDS = 150
PATIENT = 5  # rounds in which no fewer rows than ever want to change sides, after which only one does
REFINEMENTS = 30
SLACK = 0.1  # of the tolerance: how far a row may be out of its bounds, or pull on them, without a change of sides
ROUNDING = 4.0  # times the precision times the size of the velocities: a residual with nothing but rounding in it


class _Found(Pytree):
    """Impulses (R,), the velocities that they give, and the residual c - J v - C lam of all rows (R,)."""

    impulses: Array
    velocities: Array
    residual: Array


class _Round(Pytree):
    found: _Found
    sides: Array
    size: Array
    changed: Array
    fewest: Array  # rows that wanted to change sides in a round
    patience: Array
    rounds: Array
    products: Array


def search_by_elimination(
    system: System, order: RowOrder, start: Impulses, rows: FlatRows, own: Bounds, most: Array
) -> tuple[tuple[Impulses, Array], SolveInfo]:
    """Impulses within their `own` bounds and the velocities that they give; and info. Its iterations are products with
    A, of which there are no more than `most`, but for the last round's check."""
    guess, bounds = flat(start), flat_bounds(own, start)
    root = jnp.sqrt(rows.diagonal)
    scale, wanted = _sizes(system, rows.right, root)

    def at(impulses: Array) -> _Found:
        return _measured(rows, impulses, system.target + rows.moved(impulses))

    if bounds is None:
        found, size, products = _refined(order, rows, at(guess), jnp.ones_like(guess), wanted, most)
        info = _info(size, jnp.bool_(False), scale, wanted, products + 1, jnp.int32(0))
        return (rows.split(found.impulses), found.velocities), info

    low, up = bounds
    slack = SLACK * wanted / (root * guess.size**0.5)

    def trip(last: _Round) -> _Round:
        begun = at(jnp.where(last.sides < 0, low, jnp.where(last.sides > 0, up, last.found.impulses)))
        limit = jnp.minimum(REFINEMENTS, most - last.products)
        inside = (last.sides == 0).astype(root.dtype)
        found, size, products = _refined(order, rows, begun, inside, wanted, limit)
        sides = _judged(found, rows.diagonal, last.sides, slack, bounds)
        count = jnp.sum(sides != last.sides, dtype=jnp.int32)
        patience = jnp.where(count < last.fewest, PATIENT, last.patience - 1)
        sides = jnp.where(patience > 0, sides, _first_changed(sides, last.sides))
        fewest, made = jnp.minimum(last.fewest, count), last.products + products + 1
        return _Round(found, sides, size, count > 0, fewest, patience, last.rounds + 1, made)

    def running(s: _Round) -> Array:
        more: Array = s.changed & (s.rounds < ROUNDS) & (s.products < most)
        return more

    zero = jnp.int32(0)
    nothing = _Found(guess, system.target, rows.right)
    counts = jnp.int32(guess.size + 1), jnp.int32(PATIENT), zero, zero
    first = _Round(nothing, flat(sides_of(own, start)), scale, jnp.bool_(True), *counts)
    end = jax.lax.while_loop(running, trip, first)
    impulses = jnp.clip(end.found.impulses, low, up)
    velocities = end.found.velocities + rows.moved(impulses - end.found.impulses)
    weak = _weak(end, impulses, root, bounds, wanted)
    info = _info(end.size, end.changed, scale, wanted, end.products, weak)

    def go_on() -> tuple[tuple[Array, Array], SolveInfo]:
        # Neither an active set that circles nor MPRGP goes down all the way: what is worse than the start is dropped.
        best = _lower(at(jnp.clip(guess, low, up)), _measured(rows, impulses, velocities))
        stop = {"tol": wanted / jnp.where(scale > 0, scale, 1)}
        stop["max_iterations"] = jnp.where(info.status == 0, 0, most - end.products)
        further, after = mprgp_loop(rows.product, rows.right, low, up, x0=best.impulses, diagonal=rows.diagonal, **stop)
        beyond = at(further)
        best = trees.where(after.status == 0, beyond, _lower(best, beyond))
        counted = after.replace(iterations=after.iterations + end.products)
        return (best.impulses, best.velocities), counted

    (impulses, velocities), info = jax.lax.cond(info.status == 0, lambda: ((impulses, velocities), info), go_on)
    return (rows.split(impulses), velocities), info


def _sizes(system: System, right: Array, root: Array) -> tuple[Array, Array]:
    """The right side's size in scaled variables, and that of the residual to reach."""
    scale = trees.norm(right / root)
    # What a step cannot do better than: the rounding of velocities as large as those in it.
    energy = jnp.sum(system.target * apply_mass(system, system.target))
    floor = ROUNDING * jnp.finfo(scale.dtype).eps * jnp.sqrt(energy)
    return scale, jnp.maximum(system.tolerance * scale, floor)


def _info(size: Array, changed: Array, scale: Array, wanted: Array, products: Array, weak: Array) -> SolveInfo:
    good = jnp.where((size <= wanted) & ~changed, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
    status = jnp.where(jnp.isfinite(size), good, int(Status.NOT_FINITE)).astype(jnp.int32)
    return SolveInfo(status, products, size / jnp.where(scale > 0, scale, 1), weak)


def _weak(end: _Round, impulses: Array, root: Array, bounds: FlatBounds, wanted: Array) -> Array:
    """Rows at a bound with no force against it, in scaled variables."""
    box = make_box(impulses, *bounds).divided(1 / root)
    return box.weak(root * impulses, end.found.residual / root, 10 * wanted)


def _measured(rows: FlatRows, impulses: Array, velocities: Array) -> _Found:
    return _Found(impulses, velocities, rows.bias - rows.apply(velocities) - rows.compliance * impulses)


def _refined(
    order: RowOrder, rows: FlatRows, found: _Found, inside: Array, wanted: Array, limit: Array
) -> tuple[_Found, Array, Array]:
    """A lam = b on the rows `inside` their bounds (1, else 0): what is found, the residual's size there, and how many
    products.

    Conjugate gradients with residuals measured anew and the directions' own product (Golub & Ye 1999), preconditioned
    by the factor: one trip where that is exact.
    """
    scale = inside * rows.diagonal**-0.5
    precondition = row_preconditioner(order, rows, inside)

    def running(carry: Any) -> Array:
        _, residual, _, _, trips = carry
        more: Array = (trees.norm(residual) > wanted) & (trips < limit)
        return more

    def trip(carry: Any) -> Any:
        found, residual, before, direction, trips = carry
        z = precondition(residual)
        old, new = trees.dot(before, direction), trees.dot(residual - before, z)
        beta = jnp.where((trips > 0) & (old > 0), jnp.maximum(new, 0) / jnp.where(old > 0, old, 1), 0)
        direction = z + beta * direction
        change = scale * direction
        push = rows.apply_transpose(change)
        moved = apply_inverse_mass(rows.inverse, push)
        curvature = jnp.sum(push * moved) + jnp.sum(rows.compliance * change**2)
        alpha = jnp.where(curvature > 0, trees.dot(residual, direction) / jnp.where(curvature > 0, curvature, 1), 0)
        here = _measured(rows, found.impulses + alpha * change, found.velocities + alpha * moved)
        return here, scale * here.residual, residual, direction, trips + 1

    first = scale * found.residual
    found, residual, _, _, trips = jax.lax.while_loop(
        running, trip, (found, first, first, jnp.zeros_like(first), jnp.int32(0))
    )
    return found, trees.norm(residual), trips


def _lower(best: _Found, found: _Found) -> _Found:
    """The one of the lower energy 1/2 lam' A lam - b' lam, `best` where the other is not finite."""
    step = found.impulses - best.impulses
    # The energy is quadratic, and its slope less the residual: what it falls by is known without cancellation.
    fall = trees.dot(best.residual + found.residual, step)
    return trees.where(fall > 0, found, best)


def _first_changed(sides: Array, old: Array) -> Array:
    """The old sides, but for the first row of those whose side is another."""
    first = jnp.arange(sides.size) == jnp.argmax(sides != old)
    return jnp.where(first, sides, old)


def _side(lam: Array, low: Array, up: Array, slack: Any) -> Array:
    outside = jnp.where(lam <= low - slack, -1, jnp.where(lam >= up + slack, 1, 0))
    return jnp.where(low >= up, -1, outside).astype(jnp.int32)


def _judged(found: _Found, diagonal: Array, sides: Array, slack: Array, bounds: FlatBounds) -> Array:
    """Sides for the next round: where the impulse found, or a step along the residual of the rows held, leads outside.

    A held row stays unless its residual points inwards by more than the slack.
    """
    stepped = found.impulses + found.residual / diagonal
    return jnp.where(sides == 0, _side(found.impulses, *bounds, slack), _side(stepped, *bounds, -slack))
