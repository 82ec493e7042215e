"""Steps of laws that are not linear: Newton's method with a line search, around the solve of a linear one.

A step makes Phi(v) = 1/2 (v - v*)' M (v - v*) + sum of the laws' energies small, rows of joints and contacts beside.
Each round solves the step with every law's stress linearised at the last v; the way towards that solution is halved
until Phi less the work of the rows' impulses falls (Armijo). The exact tangent is tried first. Where the solve meets
negative curvature, as it does where a body buckles, a part of it is taken out of the domains that have some, and more
until none is met: the less is taken out the longer the step, and the sooner the saddle is left. With rows beside, all
of it is.
"""

from collections import OrderedDict
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import lanes_in_turn, one_trace
from jaxfem.methods.nodes.bounded import solve_bounded
from jaxfem.methods.nodes.condensed import linearised, solve_linear
from jaxfem.pytrees import Pytree
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.soft import System, merged, momentum_objective
from jaxfem.tensors import inner

Array = jax.Array
Impulses = OrderedDict[str, Array]

TRIALS = 200
SHORTEST = 2.0**-24
DESCENT = 1e-4
CALMER = 0.9
CLOSE = 100.0
"""Times what ends the rounds: with rows beside, a residual below this that falls no more is what their solve leaves."""
LEAST_SHARE = 1 / 16
"""The first share of the negative curvature that is taken out; it doubles, and falls to a quarter after a step."""
FIRST_DIGITS, MOST_DIGITS = 1e-2, 1e-6
"""Relative residuals to which a round is solved: the first, and the least that any is asked for."""


class _Point(Pytree):
    """Velocities of free triples and impulses of the extra rows, with `energy` Phi and the momentum left, `gradient`
    (its norm `size`); `iterations` and rounds so far."""

    velocities: Array
    impulses: Any
    energy: Array
    gradient: Array
    size: Array


class _Search(Pytree):
    """A point, the way from it to the solution of its linear step, and how much of that way is tried next."""

    here: _Point
    direction: Array
    towards: Any  # impulses there
    slope: Array  # of Phi less the work of those impulses, along the way
    work: Array  # of those impulses along the way
    length: Array
    fresh: Array  # whether the trial is the point itself: it always passes
    definite: Array  # share of the negative curvature that is taken out
    start: Array  # the first residual, and what ends the search
    target: Array
    least: Array
    iterations: Array
    weak: Array
    trials: Array
    status: Array


@lanes_in_turn
def solve_in_rounds(system: System, coarse: Array, guess: Any) -> tuple[Any, SolveInfo]:
    """((velocities of the free triples (n, 3), impulses of the extra rows or None), info) from such a guess."""

    def trip(s: _Search) -> _Search:
        there = _point(system, *_between(s))
        good = s.fresh | _accepted(s, there)
        here = jax.tree.map(lambda new, old: jnp.where(good, new, old), there, s.here)
        s = s.replace(here=here, trials=s.trials + 1)
        status = _judged(system, s, good)
        s = s.replace(least=jnp.minimum(s.least, here.size))
        halved = s.replace(status=status, fresh=jnp.bool_(False), length=s.length / 2)
        again = good & (status == int(Status.ITERATION_LIMIT))
        following: _Search = jax.lax.cond(again, lambda s: _directed(system, coarse, s), lambda s: s, halved)
        return following

    def running(s: _Search) -> Array:
        left = (s.iterations < system.max_iterations) & (s.trials < TRIALS)
        return (s.status == int(Status.ITERATION_LIMIT)) & left

    end = jax.lax.while_loop(running, trip, _begun(system, guess))
    relative = end.here.size / jnp.where(end.start > 0, end.start, 1)
    info = SolveInfo(end.status, end.iterations, relative, end.weak)
    return (end.here.velocities, end.here.impulses), info


def _begun(system: System, guess: Any) -> _Search:
    velocities, impulses = guess
    start, dtype = velocities * system.free[:, None], velocities.dtype
    blank = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(_point, system, start, impulses)
    )
    zero, infinite = jnp.zeros((), dtype), jnp.full((), jnp.inf, dtype)
    none, limit, yes = jnp.int32(0), jnp.int32(Status.ITERATION_LIMIT), jnp.bool_(True)
    here = blank.replace(velocities=start, impulses=impulses, size=infinite)
    still = jnp.zeros_like(start)
    one = jnp.ones((), dtype)
    return _Search(
        here, still, impulses, zero, zero, one, yes, zero, infinite, infinite, infinite, none, none, none, limit
    )


def _between(s: _Search) -> tuple[Array, Any]:
    impulses = jax.tree.map(lambda old, new: old + s.length * (new - old), s.here.impulses, s.towards)
    return s.here.velocities + s.length * s.direction, impulses


@one_trace
def _point(system: System, velocities: Array, impulses: Any) -> _Point:
    energy, gradient = momentum_objective(system, velocities)
    left = gradient - _pushed(system, impulses)
    return _Point(velocities, impulses, energy, gradient, jnp.linalg.norm(left))


def _pushed(system: System, impulses: Any) -> Array:
    """J' lam of the extra rows on free triples, (n, 3)."""
    total = jnp.zeros_like(system.target)
    for name, rows in system.extra.items():
        total = total + rows.apply_transpose(impulses[name])
    return jnp.where(system.free[:, None] > 0, total, 0)


def _accepted(s: _Search, there: _Point) -> Array:
    """Whether a trial lowers Phi less the rows' work enough, or calms what is left both on the way and in all.

    Near the solution the energy is only rounding, and the second tells (cf. Hager & Zhang 2005).
    """
    change = there.energy - s.here.energy - s.length * s.work
    lower = change <= DESCENT * s.length * s.slope
    beyond = inner(there.gradient, s.direction) - s.work
    calmer = (jnp.abs(beyond) <= CALMER * jnp.abs(s.slope)) & (there.size <= CALMER * s.here.size)
    return jnp.isfinite(there.size) & jnp.isfinite(there.energy) & (lower | calmer)


def _judged(system: System, s: _Search, good: Array) -> Array:
    """The status after a trial: done, lost, or on the way."""
    first = s.trials == 1
    start = jnp.where(first, s.here.size, s.start)
    target = jnp.where(first, jnp.maximum(system.tolerance * start, system.floor), s.target)
    size, noise = s.here.size, jnp.zeros_like(start) if system.noise is None else system.noise
    # With rows beside, a solve must have seen them, and the whole way to it must have been gone.
    seen = (s.length == 1) & ~first if system.extra else jnp.bool_(True)
    # At rest forces cancel: what the rounding of positions makes of them cannot be solved away.
    done = good & seen & ((size <= target) | ((size <= noise) & ~first & (size > 0.5 * s.least)))
    # The solve with rows has a measure of its own, the energy: what it leaves of the momentum ends the rounds too.
    close = (size <= (CLOSE if system.extra else 0) * target) & ~first
    done = done | (close & (~good | (size > 0.3 * s.least)))
    stuck = ~good & (s.length < SHORTEST)
    lost = jnp.where(size <= jnp.maximum(noise, target), int(Status.CONVERGED), int(Status.NO_DESCENT))
    status = jnp.where(stuck, lost, s.status)
    status = jnp.where(first & ~jnp.isfinite(size), int(Status.NOT_FINITE), status)
    return jnp.where(done, int(Status.CONVERGED), status).astype(jnp.int32)


def _directed(system: System, coarse: Array, s: _Search) -> _Search:
    """The search from its point towards the solution of the step linearised there."""
    here = s.here
    first = ~jnp.isfinite(s.start)
    start = jnp.where(first, here.size, s.start)
    target = jnp.where(first, jnp.maximum(system.tolerance * start, system.floor), s.target)
    # The solve with rows does not tell of negative curvature: none is left to it.
    share = 1 if system.extra else s.definite
    linear = linearised(system, merged(system, here.velocities), share)
    linear = linear.replace(max_iterations=system.max_iterations - s.iterations, floor=0.3 * target)
    if system.extra:
        (found, towards), info = solve_bounded(linear, coarse, (here.velocities, here.impulses), here.gradient)
        direction = found - here.velocities
    else:
        # No more digits than the next round will correct (Eisenstat & Walker 1996): it converges quadratically.
        digits = jnp.clip(here.size / start, MOST_DIGITS, FIRST_DIGITS).astype(start.dtype)
        linear = linear.replace(tolerance=digits)
        (found, info), towards = solve_linear(linear, coarse, -here.gradient, linear.floor), here.impulses
        direction = found * system.free[:, None]
    pushed = _pushed(system, towards)
    work, slope = inner(pushed, direction), inner(here.gradient - pushed, direction)
    solved = (info.status == int(Status.CONVERGED)) | (info.status == int(Status.ITERATION_LIMIT))
    usable = solved & jnp.isfinite(direction).all() & (slope <= 0)
    # Where the tangent is of no use the same point is tried with one that is nearer to a definite one.
    more = jnp.clip(2 * s.definite, LEAST_SHARE, 1)
    less = jnp.where(s.definite / 4 < LEAST_SHARE, 0, s.definite / 4)
    again = (s.definite < 1) & (not system.extra)
    status = jnp.where(usable | again, s.status, jnp.where(solved, int(Status.NO_DESCENT), info.status))
    return s.replace(
        direction=jnp.where(usable, direction, 0),
        towards=jax.tree.map(lambda new, old: jnp.where(usable, new, old), towards, here.impulses),
        slope=jnp.where(usable, slope, 0),
        work=jnp.where(usable, work, 0),
        length=jnp.ones_like(s.length),
        fresh=~usable,
        definite=jnp.where(usable, less, more),
        start=start,
        target=target,
        iterations=s.iterations + info.iterations,
        weak=info.weakly_active,
        status=status.astype(jnp.int32),
    )
