"""Stabilised biconjugate gradients: for linear systems without symmetry, one product a trip."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from jaxfem.pytrees import Pytree
from jaxfem.solvers import trees
from jaxfem.solvers.status import SolveInfo, Status

T = TypeVar("T")


class _State(Pytree):
    x: Any
    r: Any
    p: Any
    v: Any
    b: Any
    rho: Array
    alpha: Array
    scale: Array
    residual: Array
    iteration: Array
    status: Array


def bicgstab(
    matvec: Callable[[Any], Any],
    b: T,
    preconditioner: Callable[[Any], Any] = lambda r: r,
    *,
    tol: Any = 1e-8,
    max_iterations: Any = 1000,
    lanes: bool = False,
) -> tuple[T, SolveInfo]:
    """Solve P A x = P b, A and P regular, from x = 0 until ||P (b - A x)|| <= tol ||P b||.

    matvec: x -> A x.  b: floating array of any shape, or a pytree of arrays.  preconditioner: r -> P r.
    max_iterations counts products with A.
    A first trip makes P b; each other one is one of the method's two half steps, after each of which the residual
    holds and may end the loop: so a compiled loop holds `matvec` and `preconditioner` once. Returns x and a SolveInfo
    with ||P (b - A x)|| / ||P b||, by recurrence. `lanes`: the last axis of all arrays is one of systems by themselves,
    each of which ends on its own.
    No derivative rule. Source: van der Vorst 1992.
    """

    dot = trees.dot_by_lane if lanes else trees.dot

    def judge(residual: Array, scale: Array, sound: Any = True) -> Array:
        done = jnp.where(residual <= tol * scale, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
        broken = jnp.isfinite(residual) & sound
        return jnp.where(broken, done, int(Status.NOT_FINITE)).astype(jnp.int32)

    def running(s: _State) -> Array:
        more: Array = (s.status == Status.ITERATION_LIMIT) & (s.iteration < max_iterations)
        return more

    def trip(s: _State) -> _State:
        # first half:   v = P A p,  alpha = rho / (b'v),      x += alpha p,  r -= alpha v
        # second half:  t = P A r,  omega = (t'r) / (t't),    x += omega r,  r -= omega t,
        #               rho_new = b'r,  p <- r + rho_new / rho  alpha / omega  (p - omega v)
        opening, first = s.iteration < 0, s.iteration % 2 == 0
        direction = trees.where(first, s.p, s.r)
        product = preconditioner(trees.where(opening, b, matvec(direction)))
        above = jnp.where(first, s.rho, dot(product, s.r))
        below = jnp.where(first, dot(s.b, product), dot(product, product))
        length = jnp.where(below != 0, above / jnp.where(below != 0, below, 1), 0)
        x, r = trees.plus(s.x, length, direction), trees.plus(s.r, -length, product)
        rho = dot(s.b, r)
        safe = (length != 0) & (s.rho != 0)
        ratio = jnp.where(safe, rho * s.alpha / jnp.where(safe, s.rho * length, 1), 0)
        turned = trees.plus(r, ratio, trees.plus(s.p, -length, s.v))
        residual, scale = jnp.sqrt(dot(r, r)), jnp.sqrt(dot(product, product))
        moved = _State(
            x,
            r,
            trees.where(first, s.p, turned),
            trees.where(first, product, s.v),
            s.b,
            jnp.where(first, s.rho, rho),
            jnp.where(first, length, s.alpha),
            s.scale,
            residual,
            s.iteration + 1,
            jnp.where(residual <= tol * s.scale, judge(residual, s.scale), judge(residual, s.scale, safe)),
        )
        begun = _State(
            s.x, product, product, s.v, product, scale**2, s.alpha, scale, scale, 0 * s.iteration, judge(scale, scale)
        )
        following: _State = trees.where(opening, begun, moved)
        if not lanes:
            return following
        still: _State = trees.where(running(s), following, s)
        return still.replace(iteration=s.iteration + 1)  # all are in the same half

    zero, one = trees.zeros(b), jnp.ones(jax.eval_shape(dot, b, b).shape, trees.dtype(b))
    counts = jnp.ones(one.shape, jnp.int32)
    start = _State(zero, zero, zero, zero, zero, one, one, one, one, -counts, counts * int(Status.ITERATION_LIMIT))
    end = jax.lax.while_loop(lambda s: running(s).any(), trip, start)
    relative = end.residual / jnp.where(end.scale > 0, end.scale, 1)
    return end.x, SolveInfo(end.status, jnp.maximum(end.iteration, 0), relative, jnp.int32(0))
