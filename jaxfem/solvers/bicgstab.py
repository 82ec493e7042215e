"""Stabilised biconjugate gradients: for linear systems without symmetry, one product a trip."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxfem.pytrees import pytree
from jaxfem.solvers import trees
from jaxfem.solvers.status import SolveInfo, Status


@pytree
class _State:
    x: Any
    r: Any
    p: Any
    v: Any
    rho: Array
    alpha: Array
    residual: Array
    iteration: Array
    status: Array


def bicgstab(
    matvec: Callable[[Any], Any], b: Any, *, tol: Any = 1e-8, max_iterations: Any = 1000
) -> tuple[Any, SolveInfo]:
    """Solve A x = b, A regular, from x = 0 until ||b - A x|| <= tol ||b||.

    matvec: x -> A x.  b: floating array of any shape, or a pytree of arrays.  max_iterations counts products.
    Each trip is one of the method's two half steps, after each of which r = b - A x holds and may end the loop: so a
    compiled loop holds `matvec` once. Returns x and a SolveInfo with ||b - A x|| / ||b||, by recurrence.
    No derivative rule. Source: van der Vorst 1992.
    """
    scale = trees.norm(b)
    target = tol * scale

    def judge(residual: Array, sound: Any = True) -> Array:
        done = jnp.where(residual <= target, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
        broken = jnp.isfinite(residual) & sound
        return jnp.where(broken, done, int(Status.NOT_FINITE)).astype(jnp.int32)

    def running(s: _State) -> Array:
        return (s.status == Status.ITERATION_LIMIT) & (s.iteration < max_iterations)

    def trip(s: _State) -> _State:
        # first half:   v = A p,  alpha = rho / (b'v),      x += alpha p,  r -= alpha v
        # second half:  t = A r,  omega = (t'r) / (t't),    x += omega r,  r -= omega t,
        #               rho_new = b'r,  p <- r + rho_new / rho  alpha / omega  (p - omega v)
        first = s.iteration % 2 == 0
        direction = trees.where(first, s.p, s.r)
        product = matvec(direction)
        above = jnp.where(first, s.rho, trees.dot(product, s.r))
        below = jnp.where(first, trees.dot(b, product), trees.dot(product, product))
        length = jnp.where(below != 0, above / jnp.where(below != 0, below, 1), 0)
        x, r = trees.plus(s.x, length, direction), trees.plus(s.r, -length, product)
        rho = trees.dot(b, r)
        safe = (length != 0) & (s.rho != 0)
        ratio = jnp.where(safe, rho * s.alpha / jnp.where(safe, s.rho * length, 1), 0)
        turned = trees.plus(r, ratio, trees.plus(s.p, -length, s.v))
        residual = trees.norm(r)
        return _State(
            x,
            r,
            trees.where(first, s.p, turned),
            trees.where(first, product, s.v),
            jnp.where(first, s.rho, rho),
            jnp.where(first, length, s.alpha),
            residual,
            s.iteration + 1,
            jnp.where(residual <= target, judge(residual), judge(residual, safe)),
        )

    zero = trees.zeros(b)
    start = _State(zero, b, b, zero, scale**2, jnp.ones_like(scale), scale, jnp.int32(0), judge(scale))
    end = jax.lax.while_loop(running, trip, start)
    relative = end.residual / jnp.where(scale > 0, scale, 1)
    return end.x, SolveInfo(end.status, end.iteration, relative, jnp.int32(0))
