"""The coupled step on the impulses of all rows: elimination or MPRGP, friction bounds at their fixed point.

    min 1/2 lam' A lam - b' lam,   l <= lam <= h,   A = J M^-1 J' + C,  b = c - J v*,   then v = v* + M^-1 J' lam
(Benevolensky & Voroshilov 2009, section 3). Friction rows have h = -l = mu lam_n with lam_n of the normal row beside
them: the problem is solved with bounds from the last normal impulses until these no longer change, which is a solution
of the coupled problem (Haslinger's fixed point, 1983; not of the relaxed convex one).
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.methods.allrows.elimination import pushed, search_by_elimination
from jaxfem.methods.allrows.factor import row_preconditioner
from jaxfem.methods.allrows.gauss_seidel import projected_step, search_by_sweeps
from jaxfem.solvers import trees
from jaxfem.solvers.bicgstab import bicgstab
from jaxfem.solvers.differentiation import solved
from jaxfem.solvers.implicit import tangent_solution
from jaxfem.solvers.mprgp import mprgp_loop
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.coupled import apply_inverse_mass, inverse_mass
from jaxfem.system.soft import System

Array = jax.Array
Impulses = tuple[Array, ...]

FRICTION_ROUNDS = 100
PLAIN_ROUNDS = 8  # after these, bounds go half of the way only: where they circle, that brings them to rest
FRICTION_SLACK = 10.0  # bounds have settled when they change by no more than this times the tolerance


def solve_rows(system: System, guess: Impulses, solver: str = "mprgp") -> tuple[Array, tuple[SolveInfo, Impulses]]:
    """End-of-step velocities (n, 3), info and impulses; `guess`: impulses to start from.

    `solver`: "direct" (see `row_elimination.py`) or "mprgp", where each tangential impulse has bounds of its own (a
    pyramid), or "pgs", with the true cone.

    Differentiable in the system: on the rows found at a bound the impulse is that bound, on all others the condition
    A lam = b holds; its solution by the implicit function theorem is again one linear solve, with a symmetric matrix
    unless a friction bound is active.
    """
    if not system.rows:  # free flight
        zero = jnp.int32(0)
        return _velocities(system, ()), (SolveInfo(zero, zero, jnp.zeros((), system.target.dtype), zero), ())
    cone = solver == "pgs" and bool(system.friction)

    def solve(system: System, guess: Impulses) -> tuple[Impulses, Any]:
        found, (sides, reached), info = _search(system, guess, solver)
        return found, (sides, reached, info)

    def tangent(found: Impulses, rest: Any, arguments: tuple, pushed: Any) -> Any:
        system, sides = arguments[0], rest[0]
        right = pushed(lambda system, guess: _condition(system, sides, cone, found))
        held = jax.lax.stop_gradient(system)
        return tangent_solution(
            partial(_condition, system, sides, cone), found, right, partial(_tangent, held, sides), not system.friction
        )

    found, (sides, reached, info) = solved(solve, tangent, system, jax.lax.stop_gradient(guess))
    impulses = _settled(system, sides, found)
    velocities = _velocities(system, impulses)
    if reached is not None:  # the same velocities, but for rounding
        velocities = velocities + jax.lax.stop_gradient(reached - velocities)
    return velocities, (info, impulses)


def _condition(system: System, sides: Any, cone: bool, unknown: Impulses) -> Impulses:
    """Zero at the impulses found: A lam - b, and the unknown itself on rows at a bound, where its value is not used."""
    operator, right, diagonal = row_operator(system)
    weights, settled = jax.lax.stop_gradient(diagonal), _settled(system, sides, unknown)
    residual = trees.minus(operator(settled), right)
    if cone:
        residual = _cone_condition(system, settled, residual, weights)
    return jax.tree.map(lambda s, r, d, u: jnp.where(s == 0, r, d * u), sides, residual, weights, unknown)


def row_operator(system: System) -> tuple[Any, Impulses, Impulses]:
    """The product with A, b, and A's diagonal."""
    inverse = inverse_mass(system)

    def push(impulses: Impulses) -> Array:
        return apply_inverse_mass(inverse, pushed(system, impulses))

    def operator(impulses: Impulses) -> Impulses:
        velocities = push(impulses)
        pairs = zip(system.rows, impulses, strict=True)
        return tuple(rows.apply(velocities) + rows.compliance * lam for rows, lam in pairs)

    right = tuple(rows.bias - rows.apply(system.target) for rows in system.rows)
    return operator, right, tuple(_diagonal(rows, inverse) + rows.compliance for rows in system.rows)


def friction_radii(system: System, impulses: Impulses) -> tuple[Array, ...]:
    """mu lam_n of each pair of friction rows (m, 1), from the normal impulses given."""
    return tuple(jnp.maximum(f.coefficient[:, None] * impulses[f.normal], 0) for f in system.friction)


def row_bounds(system: System, radii: tuple[Array, ...]) -> tuple[tuple, tuple]:
    """Lower and upper bounds of all rows (None without), those of friction rows at the radii given."""
    pairs = [(None, None) if rows.bounds is None else rows.bounds for rows in system.rows]
    for each, radius in zip(system.friction, radii, strict=True):
        wide = jnp.broadcast_to(radius, system.rows[each.tangent].bias.shape)
        pairs[each.tangent] = (-wide, wide)
    return tuple(low for low, _ in pairs), tuple(up for _, up in pairs)


def _search(system: System, guess: Impulses, solver: str) -> tuple[Impulses, Any, SolveInfo]:
    """Impulses; the side of the bound that each is at (-1, 1; 0 between), and velocities if known better than from
    the impulses; and info."""
    operator, right, diagonal = row_operator(system)
    if solver == "pgs":
        found, info = search_by_sweeps(system, guess, operator, right)
        frictional = {each.tangent for each in system.friction}
        own = [(None, None) if i in frictional or r.bounds is None else r.bounds for i, r in enumerate(system.rows)]
        return found, (_sides(found, tuple(zip(*own, strict=True))), None), info

    def once(start: Impulses, radii: tuple[Array, ...]) -> tuple[Impulses, Any, SolveInfo]:
        bounds = row_bounds(system, radii)
        if solver == "direct":
            found, velocities, info = search_by_elimination(system, start, operator, right, diagonal, bounds)
            velocities = jnp.where(system.free[:, None] > 0, velocities, system.prescribed)
            return found, (_sides(found, bounds), velocities), info
        found, info = mprgp_loop(
            operator,
            right,
            *bounds,
            x0=start,
            diagonal=diagonal,
            tol=system.tolerance,
            max_iterations=system.max_iterations,
        )
        return found, (_sides(found, bounds), None), info

    if not system.friction:
        return once(guess, ())
    return _friction_rounds(system, once, guess)


def _friction_rounds(system: System, once: Any, guess: Impulses) -> tuple[Impulses, Any, SolveInfo]:
    """Solves with bounds from the last normal impulses until these fit; from some round on, halfway to them only."""

    def change(found: Impulses, radii: tuple[Array, ...]) -> Array:
        fresh = friction_radii(system, found)
        moved = sum(jnp.sum((new - old) ** 2) for new, old in zip(fresh, radii, strict=True))
        size = sum(jnp.sum(found[f.normal] ** 2) for f in system.friction)
        return jnp.sqrt(moved / jnp.where(size > 0, size, 1))

    def trip(carry: Any) -> Any:
        found, _, _, radii, _, rounds, total = carry
        fresh = friction_radii(system, found)
        part = jnp.where(rounds < PLAIN_ROUNDS, 1.0, 0.5).astype(system.target.dtype)
        radii = tuple(old + part * (new - old) for old, new in zip(radii, fresh, strict=True))
        found, sides, info = once(found, radii)
        return found, sides, info, radii, change(found, radii), rounds + 1, total + info.iterations

    def running(carry: Any) -> Array:
        _, _, info, _, moved, rounds, _ = carry
        return (moved > FRICTION_SLACK * system.tolerance) & (rounds < FRICTION_ROUNDS) & (info.status == 0)

    # Into the loop as if a round had been made, so that it is compiled once.
    radii, zero = friction_radii(system, guess), jnp.int32(0)
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(once, guess, radii))
    start = (guess, *blank[1:], radii, jnp.full((), jnp.inf, system.target.dtype), zero, zero)
    found, sides, info, _, moved, _, total = jax.lax.while_loop(running, trip, start)
    unsettled = (moved > FRICTION_SLACK * system.tolerance) & (info.status == 0)
    status = jnp.where(unsettled, int(Status.ITERATION_LIMIT), info.status).astype(jnp.int32)
    return found, sides, info.replace(iterations=total, status=status)


def _cone_condition(system: System, impulses: Impulses, residual: Impulses, weights: Impulses) -> Impulses:
    """The residual with, for friction pairs, D (lam - P(lam - residual / D)): P the projection on the cone's disc."""
    projected = projected_step(system, impulses, residual, weights)
    placed = list(residual)
    for each in system.friction:
        width = jnp.max(weights[each.tangent], -1, keepdims=True)
        placed[each.tangent] = width * (impulses[each.tangent] - projected[each.tangent])
    return tuple(placed)


def _sides(found: Impulses, bounds: tuple) -> Any:
    def side(lam: Array, low: Any, up: Any) -> Array:
        if low is None:
            return jnp.zeros(lam.shape, jnp.int32)
        return jnp.where(lam <= low, -1, jnp.where(lam >= up, 1, 0)).astype(jnp.int32)

    return tuple(side(*each) for each in zip(found, *bounds, strict=True))


def _settled(system: System, sides: Any, unknown: Impulses) -> Impulses:
    """Impulses with those at a bound put on it; friction bounds follow their own normal impulses."""

    def placed(number: int, values: Any, bounds: tuple) -> Array:
        low, up = bounds[0][number], bounds[1][number]
        if low is None:
            return values
        return jnp.where(sides[number] < 0, low, jnp.where(sides[number] > 0, up, values))

    own = tuple((None, None) if rows.bounds is None else rows.bounds for rows in system.rows)
    plain = tuple(zip(*own, strict=True))
    settled = tuple(placed(number, lam, plain) for number, lam in enumerate(unknown))
    if not system.friction:
        return settled
    bounds = row_bounds(system, friction_radii(system, settled))
    return tuple(
        placed(i, unknown[i], bounds) if any(f.tangent == i for f in system.friction) else settled[i]
        for i in range(len(unknown))
    )


def _tangent(system: System, sides: Any, matvec: Any, vector: Impulses) -> Impulses:
    """Solve the linearised condition; NaN where that fails, never a plausible number."""
    weights = row_operator(system)[2]
    if system.elimination is None:
        scaled = lambda residual: jax.tree.map(jnp.divide, residual, weights)  # noqa: E731
    else:
        scaled = _scaled_factor(system, weights, sides)

    if not system.friction:
        solution, info = pcg(matvec, vector, scaled, tol=system.tolerance, max_iterations=system.max_iterations)
        good = info.status == int(Status.CONVERGED)
    else:
        limit = system.max_iterations
        solution, info = bicgstab(matvec, vector, scaled, tol=system.tolerance, max_iterations=limit)
        good = info.residual <= jnp.sqrt(system.tolerance)
    return jax.tree.map(lambda leaf: jnp.where(good, leaf, jnp.nan), solution)


def _scaled_factor(system: System, weights: Impulses, sides: Any) -> Any:
    """The inverse of A on the rows between their bounds, and of its diagonal on the others."""
    free = jax.tree.map(lambda side, d: (side == 0).astype(d.dtype), sides, weights)
    root = jax.tree.map(jnp.sqrt, weights)
    factor = row_preconditioner(system, weights, free)

    def apply(residual: Impulses) -> Impulses:
        return jax.tree.map(jnp.divide, factor(jax.tree.map(jnp.divide, residual, root)), root)

    return apply


def _velocities(system: System, impulses: Impulses) -> Array:
    velocities = system.target + apply_inverse_mass(inverse_mass(system), pushed(system, impulses))
    return jnp.where(system.free[:, None] > 0, velocities, system.prescribed)


def _diagonal(rows: Any, inverse: tuple[Array, Array | None]) -> Array:
    return rows.diagonal(*inverse) if hasattr(rows, "triples") else rows.diagonal(inverse[0])
