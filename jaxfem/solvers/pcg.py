"""Preconditioned conjugate gradients: the linear solver that the others lean on."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxfem.pytrees import Pytree
from jaxfem.solvers import trees
from jaxfem.solvers.status import SolveInfo, Status


class _State(Pytree):
    x: Any
    r: Any
    p: Any
    rz: Array
    residual: Array
    iteration: Array
    status: Array


def default_limit(b: Any) -> int:
    """Iteration limit when the caller names none: generous, since the tolerance is what should end a solve."""
    return 100 + 10 * trees.size(b)


def pcg(
    matvec: Callable[[Any], Any],
    b: Any,
    preconditioner: Callable[[Any], Any] | None = None,
    x0: Any = None,
    tol: Any = 1e-8,
    max_iterations: Any = None,
    absolute: Any = 0.0,
) -> tuple[Any, SolveInfo]:
    """Solve A x = b, A symmetric positive definite, until ||b - A x|| <= max(tol ||b||, absolute).

    matvec: x -> A x.  b: floating array of any shape, or a pytree of arrays.  preconditioner: r -> M^-1 r, symmetric
    positive definite.  x0: start (zero without one; with one, its residual costs a product besides one a trip).
    tol, max_iterations and absolute are values: changing them compiles nothing.
    Returns x and a SolveInfo whose residual is ||b - A x|| / ||b||, by recurrence. On breakdown x is the last sound
    iterate. No derivative rule: wrap it in `jax.lax.custom_linear_solve` or call a solver that has one.
    Source: Hestenes & Stiefel 1952; Saad, Iterative Methods for Sparse Linear Systems, algorithm 9.1.
    """
    limit = default_limit(b) if max_iterations is None else max_iterations
    precondition = preconditioner or (lambda r: r)
    scale = trees.norm(b)
    target = jnp.maximum(tol * scale, absolute)

    def judge(residual: Array) -> Array:
        done = jnp.where(residual <= target, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
        return jnp.where(jnp.isfinite(residual), done, int(Status.NOT_FINITE)).astype(jnp.int32)

    def start() -> _State:
        x = trees.zeros(b) if x0 is None else x0
        r = b if x0 is None else trees.minus(b, matvec(x0))
        z = precondition(r)
        residual = trees.norm(r)
        return _State(x, r, z, trees.dot(r, z), residual, jnp.int32(0), judge(residual))

    def running(s: _State) -> Array:
        return (s.status == Status.ITERATION_LIMIT) & (s.iteration < limit)

    def trip(s: _State) -> _State:
        # alpha = r'z / p'Ap,  x += alpha p,  r -= alpha A p,  p <- z + (r'z)_new / (r'z)_old p
        Ap = matvec(s.p)
        curvature = trees.dot(s.p, Ap)
        sound = (curvature > 0) & (s.rz > 0) & jnp.isfinite(curvature)
        alpha = jnp.where(sound, s.rz / jnp.where(sound, curvature, 1), 0)
        x, r = trees.plus(s.x, alpha, s.p), trees.plus(s.r, -alpha, Ap)
        z = precondition(r)
        rz = trees.dot(r, z)
        residual = jnp.sqrt(rz) if preconditioner is None else trees.norm(r)
        p = trees.plus(z, rz / jnp.where(sound, s.rz, 1), s.p)
        finite = jnp.isfinite(curvature) & jnp.isfinite(s.rz)
        failure = jnp.where(finite, int(Status.NOT_POSITIVE_DEFINITE), int(Status.NOT_FINITE))
        status = jnp.where(sound, judge(residual), failure).astype(jnp.int32)
        x, residual = trees.where(sound, x, s.x), jnp.where(sound, residual, s.residual)
        return _State(x, r, p, rz, residual, s.iteration + 1, status)

    end = jax.lax.while_loop(running, trip, start())
    relative = end.residual / jnp.where(scale > 0, scale, 1)
    return end.x, SolveInfo(end.status, end.iteration, relative, jnp.int32(0))
