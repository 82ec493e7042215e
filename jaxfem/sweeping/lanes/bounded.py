"""A step with rows of joints and contacts, all lanes in one loop: the search of `solvers/semismooth.py`.

Its trips are halves of a few rows each, lane by lane, around a linear solve of all nodes with lanes last. That solve is
preconditioned by the modes M that lanes share, seen through what stiff rows let through: with D the diagonal blocks and
K those of the rows,
    P K P + P D M D P,    P = (D + K)^-1,
which is M itself where no row is in play.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxfem.methods.nodes.bounded import SHARPEST_TIED, row_gradient
from jaxfem.methods.nodes.extra_terms import following, held_rows, tangent_terms, terms_at
from jaxfem.methods.nodes.row_stiffness import RowStiffness, local_compliance
from jaxfem.pytrees import Pytree
from jaxfem.rows.bounds import named
from jaxfem.rows.points import PointRows
from jaxfem.solvers.bicgstab import bicgstab
from jaxfem.solvers.differentiation import solved
from jaxfem.solvers.implicit import tangent_solution
from jaxfem.solvers.row_terms import Blocks, RowTerms
from jaxfem.solvers.semismooth import REST, SHARPEST, Heading, Search, finished, headed, moved, started, unfinished
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.sweeping.lanes.beside import Impulses, lanewise, on_free_nodes
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.increments import Effort, Equation, Frames, inertia, left, operators, stiffness
from jaxfem.sweeping.lanes.kernels import AXES, diagonal_blocks, product, times
from jaxfem.sweeping.lanes.solve import Linear, Outcome, norm, solve
from jaxfem.system.soft import System
from jaxfem.tensors import inverse_blocks

Array = jax.Array
Pair = tuple[Array, Impulses]

NEARER = 0.1
"""Of the tolerance: how far what preconditions a derivative with friction is solved."""


class Parts(NamedTuple):
    """Of a step: the product with S, the modes that lanes share, and the diagonal blocks of S (nf, 3, 3, lanes)."""

    matrix: Linear
    modes: Linear
    diagonal: Array


class Begun(Pytree):
    """A search before its first trip: rows, terms, the residual at which it ends, and what that is relative to."""

    rows: tuple[PointRows, ...]
    terms: RowTerms
    first: Search
    target: Array
    scale: Array


class Stiffened(Pytree):
    """What rows in play add: `single`, blocks (nf, 3, 3, lanes) of those on one node each; `own` P K P and `through`
    D P of all, those over several nodes taken node by node; and the stiffness of these by group, None of the others.
    """

    single: Array
    own: Array
    through: Array
    several: tuple[Array | None, ...]


def increment_with_rows(
    body: Body, frames: Frames, equation: Equation, system: System, impulses: Impulses, effort: Effort
) -> tuple[Array, Impulses, Outcome]:
    """(dv (nf, 3, lanes), impulses by group, outcome) of a step, from the last `impulses`.

    Differentiable in the equation and the system; the derivative of a lane that is not converged is NaN.
    """
    arguments = body, frames, equation, system, jax.lax.stop_gradient(impulses), effort
    (change, found), outcome = solved(_solve, _change, *arguments)
    return change, found, outcome


def _solve(
    body: Body, frames: Frames, equation: Equation, system: System, impulses: Impulses, effort: Effort
) -> tuple[Pair, Outcome]:
    gradient, floor = -left(body, frames, equation, None), jnp.broadcast_to(effort.floor, effort.asked.shape)
    parts = _parts(body, frames, equation)

    def start(system: System, impulses: Impulses, v: Array, gradient: Array, diagonal: Array, floor: Array) -> Any:
        terms = terms_at(system, v[body.back], impulses)
        return _started(body, system, terms, gradient, diagonal, effort.tolerance, floor)

    given = (system, impulses, equation.velocities, gradient, parts.diagonal, floor)
    begun = body.fence(lambda: lanewise(start)(*given))
    last = _searched(body, parts, system, begun, effort)

    def end(system: System, terms: RowTerms, last: Search, scale: Array) -> tuple[Blocks, SolveInfo]:
        return finished(terms, last, scale, following(system))

    found, info = lanewise(end)(system, begun.terms, last, begun.scale)
    good, finite = info.status == int(Status.CONVERGED), info.status != int(Status.NOT_FINITE)
    return (last.step, named(impulses, found)), Outcome(info.iterations, info.residual, good, finite)


def _change(unknown: Pair, _: Outcome, arguments: Any, pushed: Callable[[Callable[..., Any]], Any]) -> Pair:
    """How the solution changes: the condition's derivative, rows at a bound held; see `methods/nodes/bounded.py`."""
    body, frames, equation, system, _, effort = arguments

    def gradient(body: Body, frames: Frames, equation: Equation, system: System, unknown: Pair) -> Pair:
        v, free = equation.velocities, body.free_count
        v = jnp.concatenate([v[:free] + unknown[0], v[free:]])
        push, residuals = lanewise(partial(_row_gradient, body))(system, v, unknown[1])
        return -left(body, frames, equation, unknown[0]) - push[:free], residuals

    right = pushed(lambda body, frames, equation, system, *_: gradient(body, frames, equation, system, unknown))
    held = jax.lax.stop_gradient((body, frames, equation, system, unknown))

    def solve(matvec: Callable[[Pair], Pair], right: Pair) -> Pair:
        near = partial(_symmetric, *held, effort)
        if not system.friction:
            found, good = near(right, effort.tolerance)
        else:
            found, info = bicgstab(
                matvec, right, lambda r: near(r, NEARER * effort.tolerance)[0], tol=effort.tolerance, lanes=True
            )
            good = info.residual <= jnp.sqrt(effort.tolerance)
        made: Pair = jax.tree.map(lambda leaf: jnp.where(good | ~effort.asked, leaf, jnp.nan), found)
        return made

    change: Pair = tangent_solution(
        lambda u: gradient(body, frames, equation, system, u), unknown, right, solve, not system.friction
    )
    return change


def _row_gradient(body: Body, system: System, v: Array, impulses: Impulses) -> Pair:
    push, residuals = row_gradient(system, v[body.back], impulses)
    return push[body.order], residuals


def _symmetric(
    body: Body,
    frames: Frames,
    equation: Equation,
    system: System,
    unknown: Pair,
    effort: Effort,
    right: Pair,
    tolerance: Array,
) -> tuple[Pair, Array]:
    """The solution with the condition's derivative where friction's bounds do not move, and which lanes have one."""
    parts = _parts(body, frames, equation)

    def start(system: System, impulses: Impulses, right: Pair, diagonal: Array) -> tuple[Blocks, Begun]:
        held = held_rows(system, impulses)
        terms = tangent_terms(system, held, tuple(right[1].values()))
        return held, _started(body, system, terms, -right[0], diagonal, tolerance, 0.0)

    held, begun = body.fence(lambda: lanewise(start)(system, unknown[1], right, parts.diagonal))
    last = _searched(body, parts, system.replace(friction={}), begun, effort)
    end = lanewise(lambda terms, last, scale: finished(terms, last, scale, None))
    found, info = end(begun.terms, last, begun.scale)
    impulses = named(right[1], map(jnp.where, held, right[1].values(), found))
    return (last.step, impulses), info.status == int(Status.CONVERGED)


def _started(
    body: Body, system: System, terms: RowTerms, gradient: Array, diagonal: Array, tolerance: Any, floor: Any
) -> Begun:
    """One lane's search before its first trip."""
    rows, inverse = on_free_nodes(body, system), inverse_blocks(diagonal)
    terms = terms.replace(local=tuple(local_compliance(each, inverse) for each in rows))
    return Begun(rows, terms, *started(rows, terms, gradient, tolerance, floor))


def _parts(body: Body, frames: Frames, equation: Equation) -> Parts:
    matrix, modes = operators(body, frames, equation)
    mass = inertia(equation.stage, equation.lane)
    return Parts(matrix, modes, diagonal_blocks(body, frames.turned, *stiffness(body, equation), mass))


def _searched(body: Body, parts: Parts, system: System, begun: Begun, effort: Effort) -> Search:
    """The search of all lanes at its end."""
    rows, terms, target, limit = begun.rows, begun.terms, begun.target, effort.limit
    first = begun.first.replace(status=jnp.where(effort.asked, begun.first.status, int(Status.CONVERGED)))
    sharpest = SHARPEST if all(map(_single, rows)) else SHARPEST_TIED

    def head(system: System, rows: Any, terms: RowTerms, target: Array, s: Search) -> tuple[Search, Heading]:
        return headed(rows, terms, target, s, following(system), sharpest)

    def trip(s: Search) -> Search:
        going = unfinished(s, limit)
        on, heading = body.fence(lambda: lanewise(head)(system, rows, terms, target, s))
        held = _stiffened(body, rows, heading.stiffness, parts.diagonal)
        hessian, seen = _with_rows(body, parts.matrix, rows, held), _preconditioner(body, parts.modes, held)
        precise = jnp.maximum(heading.depth * norm(heading.right), REST * target)
        step, found = solve(hessian, seen, heading.right, precise, going, limit)
        change, info = parts.matrix(step), _info(found)
        on = body.fence(lambda: lanewise(moved)(rows, terms, heading, on, step, change, info))
        following: Search = jax.tree.map(lambda new, old: jnp.where(going, new, old), on, s)
        return following

    last: Search = jax.lax.while_loop(lambda s: unfinished(s, limit).any(), trip, first)
    return last


def _info(found: Outcome) -> SolveInfo:
    failed = jnp.where(found.finite, int(Status.ITERATION_LIMIT), int(Status.NOT_FINITE))
    status = jnp.where(found.converged, int(Status.CONVERGED), failed).astype(jnp.int32)
    return SolveInfo(status, found.iterations, found.residual, jnp.zeros_like(status))


def _stiffened(body: Body, rows: tuple[PointRows, ...], stiffness: Blocks, diagonal: Array) -> Stiffened:
    def one(rows: Any, stiffness: Blocks, diagonal: Array) -> tuple[Array, Array, Array]:
        alone, every = jnp.zeros_like(diagonal), jnp.zeros_like(diagonal)
        for kind in map(RowStiffness, rows, stiffness):
            own = kind.node_blocks()
            every = every.at[kind.rows.triples].add(own)
            alone = alone.at[kind.rows.triples].add(own) if kind.single else alone
        return alone, every, inverse_blocks(diagonal + every)

    alone, every, smooth = body.fence(lambda: lanewise(one)(rows, stiffness, diagonal))
    own, through = product(body, product(body, smooth, every), smooth), product(body, diagonal, smooth)
    several = tuple(None if _single(each) else k for each, k in zip(rows, stiffness, strict=True))
    return Stiffened(alone, own, through, several)


def _single(rows: PointRows) -> bool:
    return rows.triples.shape[1] == 1


def _with_rows(body: Body, matrix: Linear, rows: tuple[PointRows, ...], held: Stiffened) -> Linear:
    """x -> S x + J' k J x."""

    def pushed(rows: PointRows, stiffness: Array, x: Array) -> Array:
        return rows.apply_transpose(stiffness * rows.apply(x))

    def apply(x: Array) -> Array:
        whole = matrix(x) + times(body, held.single, x)
        for each, k in zip(rows, held.several, strict=True):
            whole = whole if k is None else whole + lanewise(pushed)(each, k, x)
        return whole

    return apply


def _preconditioner(body: Body, modes: Linear, held: Stiffened) -> Linear:
    """See the head of this file."""

    def apply(x: Array) -> Array:
        found = modes(times(body, held.through, x))
        back: Array = body.fence(lambda: sum(held.through[:, j] * found[:, j, None] for j in AXES))
        return times(body, held.own, x) + back

    return apply
