"""Preconditioned conjugate gradients: the linear solver that the others lean on."""

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
    rz: Array
    square: Array
    iteration: Array
    status: Array


def default_limit(b: Any) -> int:
    """Iteration limit when the caller names none: generous, since the tolerance is what should end a solve."""
    return 100 + 10 * trees.size(b)


def pcg(
    matvec: Callable[[Any], Any],
    b: T,
    preconditioner: Callable[[Any], Any] | None = None,
    x0: Any = None,
    tol: Any = 1e-8,
    max_iterations: Any = None,
    absolute: Any = 0.0,
) -> tuple[T, SolveInfo]:
    """Solve A x = b, A symmetric positive definite, until ||b - A x|| <= max(tol ||b||, absolute).

    matvec: x -> A x.  b: floating array of any shape, or a pytree of arrays.  preconditioner: r -> M^-1 r, symmetric
    positive definite.  x0: start (zero without one; with one, its residual costs a product besides one a trip).
    tol, max_iterations and absolute are values: changing them compiles nothing.
    Returns x and a SolveInfo whose residual is ||b - A x|| / ||b||, by recurrence. On breakdown x is the last sound
    iterate. No derivative rule: wrap it in `jax.lax.custom_linear_solve` or call a solver that has one.
    Source: Hestenes & Stiefel 1952; Saad, Iterative Methods for Sparse Linear Systems, algorithm 9.1.
    """
    limit = default_limit(b) if max_iterations is None else max_iterations
    scale = trees.norm(b)
    target = jnp.maximum(tol * scale, absolute)

    def judge(square: Array) -> Array:
        residual = jnp.sqrt(square)
        done = jnp.where(residual <= target, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
        return jnp.where(jnp.isfinite(residual), done, int(Status.NOT_FINITE)).astype(jnp.int32)

    def running(s: _State) -> Array:
        return (s.status == Status.ITERATION_LIMIT) & (s.iteration < limit)

    def trip(s: _State) -> _State:
        # z = M^-1 r,  p <- z + r'z / (r'z)_old p,  alpha = r'z / p'Ap,  x += alpha p,  r -= alpha A p
        z, rz = (s.r, s.square) if preconditioner is None else _preconditioned(preconditioner, s.r)
        p = trees.plus(z, rz / jnp.where(s.rz > 0, s.rz, 1), s.p)
        Ap = matvec(p)
        curvature = trees.dot(p, Ap)
        sound = (curvature > 0) & (rz > 0) & jnp.isfinite(curvature)
        alpha = jnp.where(sound, rz / jnp.where(sound, curvature, 1), 0)
        x, r = trees.plus(s.x, alpha, p), trees.plus(s.r, -alpha, Ap)
        square = jnp.where(sound, trees.dot(r, r), s.square)
        finite = jnp.isfinite(curvature) & jnp.isfinite(rz)
        failure = jnp.where(finite, int(Status.NOT_POSITIVE_DEFINITE), int(Status.NOT_FINITE))
        status = jnp.where(sound, judge(square), failure).astype(jnp.int32)
        return _State(trees.where(sound, x, s.x), r, p, rz, square, s.iteration + 1, status)

    # The first direction is z alone, as the one before it is zero: so a program holds `preconditioner` once.
    x = trees.zeros(b) if x0 is None else x0
    r = b if x0 is None else trees.minus(b, matvec(x0))
    square = trees.dot(r, r)
    first = _State(x, r, trees.zeros(b), jnp.ones_like(square), square, jnp.int32(0), judge(square))
    end = jax.lax.while_loop(running, trip, first)
    relative = jnp.sqrt(end.square) / jnp.where(scale > 0, scale, 1)
    return end.x, SolveInfo(end.status, end.iteration, relative, jnp.int32(0))


def _preconditioned(preconditioner: Callable[[Any], Any], r: Any) -> tuple[Any, Array]:
    z = preconditioner(r)
    return z, trees.dot(r, z)
