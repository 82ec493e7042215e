"""Newton's method with truncated conjugate gradients and a line search, for minima of smooth energies."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import one_trace
from jaxfem.pytrees import Pytree
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.tensors import inner

Array = jax.Array
Operator = Callable[[Array], Array]

_SHORTEST = 1e-6
_DESCENT = 1e-4
LAST_STEP = 0.02
"""Share of the way from the start that may be left to go where rounding ends it."""


class Evaluation(Pytree):
    """What the method needs at a point x: `energy` of the conservative part, the whole `gradient`, and the dead `load`
    (the part of -gradient that is not in the energy). Residuals are measured by `scale`; below `noise` a gradient may
    be only rounding, and is where the next step is small beside the way made. `aux` is handed on to `tangent`."""

    energy: Array
    gradient: Array
    load: Array
    scale: Array
    noise: Array
    aux: Any = None


class _State(Pytree):
    x: Array
    here: Evaluation
    direction: Array
    length: Array
    iteration: Array
    inner: Array
    status: Array


def minimize_newton(
    evaluate: Callable[[Array], Evaluation],
    tangent: Callable[[Array, Any], tuple[Operator, Operator]],
    start: Array,
    *,
    tol: Any,
    max_iterations: Any = 200,
    max_inner: Any = 10_000,
) -> tuple[Array, SolveInfo]:
    """Find x with ||gradient|| <= tol scale, descending the energy less the work of the (momentarily frozen) load.

    `tangent(x, aux)` returns products with the Hessian and with an SPD approximation of its inverse. Inner solves stop
    early far from the solution (Eisenstat & Walker 1996) and at negative curvature (Steihaug 1983); `max_inner` bounds
    the iterations of all of them together. Returns x and an info whose iterations count trial points, and whose
    residual is relative to scale.
    """

    def direction_at(x: Array, here: Evaluation, direction: Array, inner: Array) -> tuple[Array, Array]:
        found, trips = _direction(*tangent(x, here.aux), here, max_inner - inner)
        return found, inner + trips

    def trip(s: _State) -> _State:
        # One trial point a trip: either it is good and a new direction starts there, or the step is halved.
        x = s.x + s.length * s.direction
        there = evaluate(x)
        good = _accepted(s, x, there)
        x = jnp.where(good, x, s.x)
        here = jax.tree.map(lambda new, old: jnp.where(good, new, old), there, s.here)
        length = jnp.where(good, 1.0, s.length / 2).astype(x.dtype)
        verdict = _judged(here, tol)
        again = good & (verdict == Status.ITERATION_LIMIT)
        direction, inner = jax.lax.cond(again, direction_at, lambda x, here, *old: old, x, here, s.direction, s.inner)
        lost = jnp.where(length < _SHORTEST, int(Status.NO_DESCENT), verdict)
        ended = (again | (length < _SHORTEST)) & _at_rounding(x - start, here, direction)
        status = jnp.where(ended, int(Status.CONVERGED), lost).astype(jnp.int32)
        return _State(x, here, direction, length, s.iteration + 1, inner, status)

    evaluate = one_trace(evaluate)
    # The first trial is the start itself, so that `evaluate` is compiled once.
    blank = jax.tree.map(lambda a: jnp.full(a.shape, jnp.inf, a.dtype), jax.eval_shape(evaluate, start))
    limit = jnp.int32(Status.ITERATION_LIMIT)
    first = _State(start, blank, jnp.zeros_like(start), jnp.ones((), start.dtype), jnp.int32(0), jnp.int32(0), limit)

    def running(s: _State) -> Array:
        more: Array = (s.status == Status.ITERATION_LIMIT) & (s.iteration < max_iterations) & (s.inner < max_inner)
        return more

    last = jax.lax.while_loop(running, trip, first)
    residual = jnp.linalg.norm(last.here.gradient) / last.here.scale
    return last.x, SolveInfo(last.status, last.iteration, residual, jnp.int32(0))


def _judged(here: Evaluation, tol: Any) -> Array:
    residual = jnp.linalg.norm(here.gradient) / here.scale
    code = jnp.where(residual <= tol, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
    return jnp.where(jnp.isfinite(residual), code, int(Status.NOT_FINITE)).astype(jnp.int32)


def _at_rounding(way: Array, here: Evaluation, direction: Array) -> Array:
    """A gradient of rounding ends the `way`, where the step that it asks for is small beside what is already made."""
    little = jnp.linalg.norm(direction) <= LAST_STEP * jnp.linalg.norm(way)
    ended: Array = (jnp.linalg.norm(here.gradient) <= here.noise) & (little | ~jnp.any(here.load))
    return ended


def _direction(hessian: Operator, precondition: Operator, here: Evaluation, max_inner: Any) -> tuple[Array, Array]:
    """Truncated Newton direction, the preconditioned gradient where curvature is negative at once; and its trips."""
    residual = jnp.linalg.norm(here.gradient) / here.scale
    # At rounding level the next gradient will tell nothing new: what can be known of the step is used at once.
    known = jnp.linalg.norm(here.gradient) <= here.noise
    tolerance = jnp.where(known, 1e-3, jnp.clip(jnp.sqrt(residual), 1e-5, 0.1))
    direction, info = pcg(hessian, -here.gradient, precondition, tol=tolerance, max_iterations=max_inner)
    usable = jnp.isfinite(direction).all() & (inner(direction, here.gradient) < 0)
    return jnp.where(usable, direction, precondition(-here.gradient)), info.iterations


def _accepted(s: _State, x: Array, there: Evaluation) -> Array:
    """Whether a trial point lowers the energy enough or, at rounding level, the gradient; the start always passes."""
    here = s.here
    start = jnp.isinf(here.energy)
    here = jax.tree.map(lambda a: jnp.where(start, 0.0, a), here)
    slope = s.length * inner(here.gradient, s.direction)
    change = there.energy - here.energy - s.length * inner(here.load, s.direction)
    # Energies are known to about the rounding of positions times the forces on them.
    noise = 8 * jnp.finfo(x.dtype).eps * (jnp.abs(here.energy) + here.scale * jnp.linalg.norm(x))
    flat = jnp.abs(slope) <= noise
    calmer = jnp.linalg.norm(there.gradient) < jnp.linalg.norm(here.gradient)
    finite = jnp.isfinite(there.gradient).all()
    return start | (finite & jnp.where(flat, calmer, change <= _DESCENT * slope))
