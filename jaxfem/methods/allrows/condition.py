"""A step on the impulses of all rows, and the derivative that its condition implies.

    min 1/2 lam' A lam - b' lam,   l <= lam <= h,   A = J M^-1 J' + C,  b = c - J v*,   then v = v* + M^-1 J' lam
(Benevolensky & Voroshilov 2009, section 3). Friction rows have h = -l = mu lam_n with lam_n of the normal row beside
them. The searches (`mprgp.py`, `direct.py`, `sweeps.py`) find the impulses; the rest is the same for all.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from jaxfem.batching import cond_any
from jaxfem.methods.allrows.cone import projected_step
from jaxfem.methods.allrows.dense import FEW, MOST, by_elimination, left_over, scaled_size
from jaxfem.methods.allrows.factor import row_preconditioner
from jaxfem.methods.allrows.flat import flat, flat_rows, split
from jaxfem.methods.allrows.operator import RowOperator, row_operator, velocities_from
from jaxfem.methods.base import Solved
from jaxfem.pytrees import Pytree
from jaxfem.rows.bounds import HELD, STILL, Impulses, named, placed_at_bounds, turned, without_cones
from jaxfem.solvers import trees
from jaxfem.solvers.bicgstab import bicgstab
from jaxfem.solvers.differentiation import solved
from jaxfem.solvers.implicit import tangent_solution
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.coupled import TRACE
from jaxfem.system.soft import System

Array = jax.Array

TRACED = 1e-3  # of the trace of compliance: tolerance of derivatives with friction
MET = 10.0  # times the tolerance: the residual, not preconditioned, with which a derivative's solve has converged
PATIENCE = 4  # iterations a row, after which a matrix that is not too large is eliminated


class Found(Pytree):
    """What a search found: impulses, the side of its bounds that each is at (-1, 1; 0 between), info, and velocities
    (n, 3) where they are known better than from the impulses."""

    impulses: Impulses
    sides: Impulses
    info: SolveInfo
    velocities: Array | None = None


class Search(Protocol):
    """A way to find the impulses of all rows; hashable, holds no arrays."""

    @property
    def cone(self) -> bool:
        """Whether it holds friction in the true cone; else each tangential impulse has bounds of its own."""

    def found(self, system: System, plan: Any, operator: RowOperator, guess: Impulses) -> Found:
        """The impulses, from a guess; never differentiated. `plan`: what its method made of the topology."""


def solve_rows(system: System, plan: Any, guess: Impulses, search: Search) -> Solved:
    """The step's solution, from the impulses `guess` to start from.

    Differentiable in the system: on the rows found at a bound the impulse is that bound, on all others the condition
    A lam = b holds; its solution by the implicit function theorem is again one linear solve, with a symmetric matrix
    unless a friction bound is active.
    """
    if not system.rows:  # free flight
        zero = jnp.int32(0)
        info = SolveInfo(zero, zero, jnp.zeros((), system.target.dtype), zero)
        return Solved(velocities_from(system, named((), ())), named((), ()), info)
    cone = any(search.cone or each.cone for each in system.friction.values())

    def solve(system: System, plan: Any, guess: Impulses) -> tuple[Impulses, Any]:
        best = search.found(system, plan, row_operator(system), guess)
        sides = without_cones(system.friction, best.sides)
        impulses = placed_at_bounds(system.rows, system.friction, sides, best.impulses)
        return impulses, (sides, best.velocities, best.info)

    def tangent(found: Impulses, rest: Any, arguments: tuple[System, Any, Impulses], pushed: Any) -> Any:
        system, plan, _ = arguments
        held = jax.lax.stop_gradient(system)
        sides = _sliding(held, jax.lax.stop_gradient(found), rest[0])
        right = pushed(lambda system, plan, guess: _condition(system, sides, cone, search.cone, found))
        change = tangent_solution(
            partial(_condition, system, sides, cone, search.cone),
            found,
            right,
            partial(_tangent, held, plan, sides),
            not system.friction,
        )
        # What is at a bound follows it: by the system itself, and by the normal impulses of the solution.
        bound = pushed(lambda system, plan, guess: placed_at_bounds(system.rows, system.friction, sides, found))
        own = jax.jvp(partial(placed_at_bounds, system.rows, system.friction, sides), (found,), (change,))[1]
        return trees.plus(bound, 1, own)

    impulses, (_, reached, info) = solved(solve, tangent, system, plan, jax.lax.stop_gradient(guess))
    velocities = velocities_from(system, impulses)
    if reached is not None:  # the same velocities, but for rounding
        velocities = velocities + jax.lax.stop_gradient(reached - velocities)
    return Solved(velocities, impulses, info)


def _sliding(system: System, impulses: Impulses, sides: Impulses) -> Impulses:
    """`sides`, with friction at a bound where nothing slides taken for friction between its bounds.

    Of redundant points at rest, as the corners of a box, some may push against others with all that they can, and only
    a trace of compliance says that they need not. Held at their bounds they would be said to follow these. What has no
    room between its bounds is `turned`.
    """
    if not system.friction:
        return sides
    operator = row_operator(system)
    speed = trees.minus(operator.apply(impulses), operator.right)
    least = STILL * system.tolerance * scaled_size(operator.right, operator.diagonal)
    moved = sides.copy()
    for name in system.friction:
        still = jnp.abs(speed[name]) <= least * jnp.sqrt(operator.diagonal[name])
        own = turned(sides[name], impulses[name], speed[name], still)
        moved[name] = jnp.where(still & (own != HELD), 0, own)
    return moved


def _condition(system: System, sides: Impulses, cone: bool, every: bool, unknown: Impulses) -> Impulses:
    """Zero at the impulses found: A lam - b, and the unknown itself on rows at a bound, where its value is not used.

    `cone`: whether any friction is in the true cone; `every`: whether all is.
    """
    operator = row_operator(system)
    weights = jax.lax.stop_gradient(operator.diagonal)
    settled = placed_at_bounds(system.rows, system.friction, sides, unknown)
    residual = trees.minus(operator.apply(settled), operator.right)
    if cone:
        residual = _cone_condition(system, settled, residual, weights, every)
    residuals: Impulses = jax.tree.map(
        lambda s, r, d, u: jnp.where(s == 0, r, d * u), sides, residual, weights, unknown
    )
    return residuals


def _cone_condition(system: System, impulses: Impulses, residual: Impulses, weights: Impulses, every: bool) -> Impulses:
    """The residual with, for friction pairs, D (lam - P(lam - residual / D)): P the projection on the cone's disc."""
    projected = projected_step(system, impulses, residual, weights)
    changed = residual.copy()
    for name, each in system.friction.items():
        if not (every or each.cone):
            continue
        width = jnp.max(weights[name], -1, keepdims=True)
        changed[name] = width * (impulses[name] - projected[name])
    return changed


def _tangent(system: System, plan: Any, sides: Impulses, matvec: Any, vector: Impulses) -> Impulses:
    """Solve the linearised condition; NaN where that fails, never a plausible number."""
    operator, right = row_operator(system), flat(vector)
    weights = flat(operator.diagonal)

    def product(unknown: Array) -> Array:
        return flat(matvec(split(unknown, vector)))

    if system.friction and _double(system) and right.size <= FEW:
        solution, info = by_elimination(product, right, weights)
        good = info.residual <= jnp.sqrt(system.tolerance)
    else:
        by_diagonal = _by_diagonal(weights)
        scaled = by_diagonal if plan is None else _by_factor(system, plan, operator, sides)
        solution, good = _iterated(system, product, right, weights, scaled, by_diagonal)
    return split(jnp.where(good, solution, jnp.nan), vector)


def _iterated(
    system: System, product: Any, right: Array, weights: Array, scaled: Any, by_diagonal: Any
) -> tuple[Array, Array]:
    """The solution by iterations, and whether it is one; preconditioned by `scaled`, else `by_diagonal`."""
    tol, limit = system.tolerance, system.max_iterations
    if not system.friction:
        solution, info = pcg(product, right, scaled, tol=tol, max_iterations=limit)
        return solution, info.status == int(Status.CONVERGED)
    # Redundant rows share by their trace of compliance alone: a residual that leaves that out tells nothing. In
    # single precision rounding hides it.
    if _double(system):
        tol = jnp.minimum(tol, TRACED * TRACE[True])
    made = right.size <= MOST
    if made:
        limit = jnp.minimum(limit, PATIENCE * right.size)
    left = partial(left_over, product, right, weights)
    found = _checked(*bicgstab(product, right, scaled, tol=tol, max_iterations=limit), left, system.tolerance)
    if made:
        found = _retried(*found, left, partial(by_elimination, product, right, weights))
    elif scaled is not by_diagonal and (any(each.cone for each in system.friction.values()) or not _double(system)):
        again = partial(bicgstab, product, right, by_diagonal, tol=tol, max_iterations=limit)
        found = _retried(*found, left, again)
    solution, info = found
    good = info.residual <= jnp.sqrt(system.tolerance)
    if not made:  # where nothing was eliminated, what has not converged may be wrong altogether (see `_retried`)
        good = good & (info.status == int(Status.CONVERGED))
    return solution, good


def _double(system: System) -> bool:
    return system.target.dtype.itemsize > 4


def _checked(solution: Array, info: SolveInfo, left: Any, tolerance: Array) -> tuple[Array, SolveInfo]:
    """The solution, with info of the residual that it leaves, `left`, instead of the preconditioned one.

    The inverse on redundant rows carries what only their trace holds up to a million times its size. A residual that is
    small beside that says nothing about all the others.
    """
    size = left(solution)
    met = (info.status == int(Status.CONVERGED)) & (size <= MET * tolerance)
    status = jnp.where(met | (info.status == int(Status.NOT_FINITE)), info.status, int(Status.ITERATION_LIMIT))
    return solution, info.replace(residual=size, status=status.astype(jnp.int32))


def _retried(solution: Array, info: SolveInfo, left: Any, again: Any) -> tuple[Array, SolveInfo]:
    """The better of a solution and of another try, made where it has not converged; judged by what both leave, `left`.

    In single precision the elimination of redundant rows, as those of four corners that stick, may keep no digit; and
    it does not know how a cone ties a pair of rows to each other and to its normal. Backwards, where some of the rows
    that share by a trace slide and others stick, a residual of 1e-7 stays, of a solution that is wrong altogether.
    """

    def other(solution: Array, info: SolveInfo) -> tuple[Array, SolveInfo]:
        second, how = again()
        how = how.replace(residual=left(second))
        better = (how.residual <= info.residual) | ~jnp.isfinite(info.residual)
        return trees.where(better, (second, how), (solution, info))

    missed = info.status != int(Status.CONVERGED)
    best: tuple[Array, SolveInfo] = cond_any(missed, other, lambda solution, info: (solution, info), solution, info)
    return best


def _by_diagonal(weights: Array) -> Callable[[Array], Array]:
    return lambda residual: residual / weights


def _by_factor(system: System, plan: Any, operator: RowOperator, sides: Impulses) -> Callable[[Array], Array]:
    """The inverse of A on the rows between their bounds, and of its diagonal on the others."""
    rows = flat_rows(system, operator)
    factor = row_preconditioner(plan, rows, (flat(sides) == 0).astype(rows.diagonal.dtype))
    root = jnp.sqrt(rows.diagonal)
    return lambda residual: factor(residual / root) / root
