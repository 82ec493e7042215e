"""Semismooth Newton for a large quadratic and some bounded rows, which may be as stiff as they like.

The rows' penalty form, a piecewise quadratic, is minimised by Newton steps on its active set with an exact line search.
Alone, that breaks down for rows of tiny compliance: their penalty is ill-conditioned, and the search stops at the first
row that it meets. So a row is given at least a share of its nodes' own compliance, and the method of multipliers (a
proximal point method on the dual, Rockafellar 1976) takes the difference back: the centre moves to the impulses found.
Both converge from anywhere. The share starts near one, where many rows change in one step, and falls as they settle.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree
from jaxfem.solvers import trees
from jaxfem.solvers.anderson import History, accelerated, empty
from jaxfem.solvers.box import where_at
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.row_terms import Blocks, Bounds, RowTerms
from jaxfem.solvers.status import SolveInfo, Status

Array = jax.Array
Operator = Callable[[Array], Array]
Follow = Callable[[Blocks, Blocks], Bounds]

START, SHARPER, SHARPEST = 0.3, 0.1, 1e-3
"""The first share of compliance, the factor by which it falls each time that the active set has settled, its end."""
FORCING, CLOSE = 0.1, 1e-2
"""Relative residual of a Newton step's linear solve, while the active set changes and once it is the last step's."""
SEARCHES = 12
"""Newton steps of the line search: it ends exactly once it is on the right piece."""
REST = 0.7
"""Of the residual at which the search ends: what a linear solve may leave."""
MOST_TRIPS = 400
WORSE = 5.0
"""Growth of the rows' violation at which an accelerated move is taken back."""


class RowOperator(Protocol):
    """J of one kind of rows."""

    def apply(self, velocities: Array) -> Array:
        """J x."""

    def apply_transpose(self, impulses: Array) -> Array:
        """J' lam."""


class Search(Pytree):
    """How far a search has come. `centre`: of the multipliers; `history` of its moves; `plain`, `far`: impulses and
    violation that the last move not taken back started from."""

    step: Array
    gradient: Array
    slack: Blocks
    centre: Blocks
    history: History
    plain: Blocks
    far: Array
    bounds: Bounds
    share: Array
    inside: Blocks
    iteration: Array
    trips: Array
    residual: Array
    status: Array


class Heading(Pytree):
    """What a Newton step starts from: softened compliance `soft`, the `stiffness` of the rows in play, the right side
    `right`, and the relative residual `depth` to which it is solved."""

    soft: Blocks
    stiffness: Blocks
    right: Array
    depth: Array


def minimize_with_rows(
    matvec: Operator,
    gradient: Array,
    rows: Sequence[RowOperator],
    terms: RowTerms,
    preconditioner: Callable[[Blocks], Operator],
    *,
    tol: Any,
    max_iterations: Any,
    absolute: Any = 0.0,
    follow: Follow | None = None,
    stiffened: Callable[[Blocks], Operator] | None = None,
    sharpest: float = SHARPEST,
) -> tuple[tuple[Array, Blocks], SolveInfo]:
    """Find the step d and impulses lam with  gradient + S d = J' lam  and  slack - J d - C lam  complementary to
    lower <= lam <= upper:  ((d, lam), info).

    matvec: d -> S d, S symmetric positive definite.  preconditioner: stiffness of the rows in play (zero for others)
    -> an SPD approximation of (S + J' stiffness J)^-1.  stiffened: stiffness -> the product with S + J' stiffness J,
    where there is a faster one than by the rows.
    Stops when sqrt(|gradient + S d - J' lam|^2 + |J' violation|^2), see `RowTerms.violation`, is at most max(tol times
    its value at the start with no impulses, absolute). max_iterations counts the inner iterations of conjugate
    gradients, as info.iterations does. `follow`: (impulses, slack) -> bounds, where these depend on other rows'
    impulses (friction): each move of the centre takes them anew, and the violation is judged by the new ones (Haslinger
    1983, in the same loop); `terms` holds the first. `sharpest`: where the share of compliance ends; near one where the
    preconditioner bears stiff rows badly. No derivative rule. Lanes that have arrived stay.
    """
    first, target, scale = started(rows, terms, gradient, tol, absolute)

    def trip(s: Search) -> Search:
        s, heading = headed(rows, terms, target, s, follow, sharpest)
        limit = max_iterations - s.iteration
        precondition = preconditioner(heading.stiffness)
        hessian = _with_penalty(matvec, rows, heading.stiffness) if stiffened is None else stiffened(heading.stiffness)
        rest, depth = REST * target, heading.depth
        step, info = pcg(hessian, heading.right, precondition, tol=depth, max_iterations=limit, absolute=rest)
        return moved(rows, terms, heading, s, step, matvec(step), info)

    last = jax.lax.while_loop(lambda s: unfinished(s, max_iterations), trip, first)
    found, info = finished(terms, last, scale, follow)
    return (last.step, found), info


def started(
    rows: Sequence[RowOperator], terms: RowTerms, gradient: Array, tol: Any, absolute: Any
) -> tuple[Search, Array, Array]:
    """The search before its first trip, the residual at which it ends, and what that is relative to."""
    none = trees.zeros(terms.start)
    scale = jnp.sqrt(trees.dot(gradient, gradient) + _size(rows, terms.violation(terms.slack, none)) ** 2)
    target = jnp.maximum(tol * scale, absolute)
    one = jnp.ones((), gradient.dtype)
    counts = jnp.int32(0), jnp.int32(0), 0 * one, jnp.int32(Status.ITERATION_LIMIT)
    start = terms.bounded(terms.start)
    bounds, inside = (terms.lower, terms.upper), terms.inside(start)
    moves = empty(start), start, jnp.inf * one
    first = Search(0 * gradient, gradient, terms.slack, start, *moves, bounds, START * one, inside, *counts)
    return first, target, scale


def unfinished(s: Search, max_iterations: Any) -> Array:
    """Whether a search goes on."""
    more: Array = (s.status == Status.ITERATION_LIMIT) & (s.trips < MOST_TRIPS) & (s.iteration < max_iterations)
    return more


def headed(
    rows: Sequence[RowOperator], terms: RowTerms, target: Array, s: Search, follow: Follow | None, sharpest: float
) -> tuple[Search, Heading]:
    """The first half of a trip: the search judged, its centre moved where it must be, and what to solve for next."""
    before = s.inside
    s, soft, impulses, inside = _settle(rows, terms, target, s, follow, sharpest)
    stiffness = tuple(jnp.where(f, 1 / q, 0) for f, q in zip(inside, soft, strict=True))
    going = s.status == Status.ITERATION_LIMIT
    right = jnp.where(going, _push(rows, impulses) - s.gradient, 0)
    depth = jnp.where(_same(inside, before), CLOSE, FORCING).astype(right.dtype)
    return s, Heading(soft, stiffness, right, depth)


def moved(
    rows: Sequence[RowOperator],
    terms: RowTerms,
    heading: Heading,
    s: Search,
    step: Array,
    change: Array,
    info: SolveInfo,
) -> Search:
    """The second half: the search moved along the `step` that was solved for, `change` = S step, as far as it pays."""
    going = s.status == Status.ITERATION_LIMIT
    along = tuple(each.apply(step) for each in rows)
    length = jnp.where(going, _exact_length(terms.within(s.bounds), heading.soft, s, step, change, along), 0)
    further = s.replace(
        step=s.step + length * step,
        gradient=s.gradient + length * change,
        slack=tuple(a - length * b for a, b in zip(s.slack, along, strict=True)),
        iteration=s.iteration + info.iterations,
        trips=s.trips + 1,
        status=jnp.where(going, info.status, s.status),
    )
    # A solve that converged has only made a step; one that did not ends the loop with its status.
    again = going & (info.status == Status.CONVERGED)
    return further.replace(status=jnp.where(again, int(Status.ITERATION_LIMIT), further.status).astype(jnp.int32))


def finished(terms: RowTerms, last: Search, scale: Array, follow: Follow | None) -> tuple[Blocks, SolveInfo]:
    """Impulses at the end of a search, and how it went."""
    impulses = terms.within(last.bounds).bounded(terms.raw(last.slack, last.centre, terms.softened(last.share)))
    if follow is not None:
        impulses = _snapped(impulses, last.bounds, follow(impulses, last.slack))
    relative = last.residual / jnp.where(scale > 0, scale, 1)
    return impulses, SolveInfo(last.status, last.iteration, relative, jnp.int32(0))


def _with_penalty(matvec: Operator, rows: Sequence[RowOperator], stiffness: Blocks) -> Operator:
    """x -> S x + J' stiffness J x."""

    def apply(x: Array) -> Array:
        moved = tuple(k * each.apply(x) for k, each in zip(stiffness, rows, strict=True))
        return matvec(x) + _push(rows, moved)

    return apply


def _settle(
    rows: Sequence[RowOperator],
    terms: RowTerms,
    target: Array,
    s: Search,
    follow: Follow | None,
    sharpest: float,
) -> tuple[Search, Blocks, Blocks, Blocks]:
    """Judge the point reached, and move the centre where the rows are what is left to do.

    Returns the state, and what the next Newton step starts from: softened compliance, impulses, masks of rows inside.
    """
    soft = terms.softened(s.share)
    raw, old = terms.raw(s.slack, s.centre, soft), terms.within(s.bounds)
    impulses, inside = old.bounded(raw), old.inside(raw)
    wanted = s.bounds if follow is None else follow(impulses, s.slack)
    near = trees.norm(s.gradient - _push(rows, impulses))
    far = _size(rows, terms.within(wanted).violation(s.slack, impulses))
    residual = jnp.sqrt(near**2 + far**2)
    done = jnp.where(residual <= target, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
    status = jnp.where(jnp.isfinite(residual), done, int(Status.NOT_FINITE)).astype(jnp.int32)
    moving = (near <= jnp.maximum(0.5 * far, REST * target)) & (status == Status.ITERATION_LIMIT)
    share = jnp.where(moving & _same(inside, s.inside), jnp.maximum(SHARPER * s.share, sharpest), s.share)
    # An accelerated move (the second that is known, or later) that made matters worse is taken back.
    worse = moving & (s.history.count > 1) & (far > WORSE * s.far)
    kept = trees.where(share == s.share, s.history, empty(s.centre))
    ahead, history = accelerated(kept, s.centre, impulses, terms.local)
    ahead, history = trees.where(worse, (s.plain, empty(s.centre)), (ahead, history))
    centre, history = trees.where(moving, (ahead, history), (s.centre, s.history))
    bounds = s.bounds if follow is None else trees.where(moving, follow(ahead, s.slack), s.bounds)
    taken = moving & ~worse
    settled = s.replace(
        history=history,
        plain=trees.where(taken, impulses, s.plain),
        far=jnp.where(taken, far, s.far),
        centre=centre,
        bounds=bounds,
        share=share,
        residual=residual,
        status=status,
    )
    soft, new = terms.softened(share), terms.within(bounds)
    raw = terms.raw(s.slack, centre, soft)
    return settled.replace(inside=new.inside(raw)), soft, new.bounded(raw), new.inside(raw)


def _same(a: Blocks, b: Blocks) -> Array:
    return jnp.stack([jnp.all(one == other) for one, other in zip(a, b, strict=True)]).all()


def _snapped(impulses: Blocks, old: Bounds, new: Bounds) -> Blocks:
    """Impulses with those at an old bound put on the new one, and all within the new ones."""

    def placed(lam: Array, old_low: Any, old_up: Any, low: Any, up: Any) -> Array:
        if low is None:
            return lam
        at_low, at_up, _ = where_at(old_low, old_up, lam)
        return jnp.where(at_up, up, jnp.where(at_low, low, jnp.clip(lam, low, up)))

    return tuple(placed(*each) for each in zip(impulses, *old, *new, strict=True))


def _exact_length(terms: RowTerms, soft: Blocks, s: Search, step: Array, change: Array, along: Blocks) -> Array:
    """The minimiser t of the penalty form along `step`: the root of a rising piecewise linear function.

    slope(t) = step' (gradient + t S step) - (J step)' lam(t); Newton's method on it, within a bracket.
    """
    if all(low is None for low in terms.lower):
        return jnp.ones((), step.dtype)
    constant, curvature = trees.dot(step, s.gradient), trees.dot(step, change)

    def slope(t: Array) -> tuple[Array, Array]:
        raw = terms.raw(tuple(a - t * b for a, b in zip(s.slack, along, strict=True)), s.centre, soft)
        stiff = tuple(jnp.where(f, b / q, 0) for f, b, q in zip(terms.inside(raw), along, soft, strict=True))
        value = constant + t * curvature - trees.dot(along, terms.bounded(raw))
        return value, curvature + trees.dot(along, stiff)

    def refine(_: int, bracket: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        t, low, high = bracket
        value, rate = slope(t)
        low, high = jnp.where(value < 0, t, low), jnp.where(value < 0, high, t)
        newton = t - value / jnp.where(rate > 0, rate, 1)
        middle = jnp.where(jnp.isfinite(high), 0.5 * (low + high), newton)
        return jnp.where((newton >= low) & (newton <= high), newton, middle), low, high

    one = jnp.ones((), step.dtype)
    length: Array = jax.lax.fori_loop(0, SEARCHES, refine, (one, 0 * one, jnp.inf * one))[0]
    return length


def _push(rows: Sequence[RowOperator], impulses: Blocks) -> Array:
    parts = [each.apply_transpose(z) for each, z in zip(rows, impulses, strict=True)]
    return sum(parts[1:], start=parts[0])


def _size(rows: Sequence[RowOperator], impulses: Blocks) -> Array:
    return trees.norm(_push(rows, impulses))
