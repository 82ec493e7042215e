"""Projected Gauss-Seidel: one entry after the other, each put where it is best and then back into the box.

The baseline that Benevolensky & Voroshilov 2009 compare with. It needs no norm and takes any convex set that is a
product of small ones, but its error falls slowly along chains.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxfem.solvers import trees
from jaxfem.solvers.box import make_box
from jaxfem.solvers.pcg import default_limit
from jaxfem.solvers.status import SolveInfo, Status


def pgs(
    A: Any,
    b: Any,
    lower: Any = None,
    upper: Any = None,
    *,
    x0: Any = None,
    tol: Any = 1e-8,
    max_iterations: Any = None,
) -> tuple[Array, SolveInfo]:
    """Minimise 1/2 x'Ax - b'x over lower <= x <= upper by projected Gauss-Seidel: (x, info), x of shape (n,).

    A: symmetric positive definite (n, n).  b: (n,).  lower, upper: None, scalars or (n,).  x0: start (n,).
    Stops as `mprgp` does, and info means the same; an iteration is one sweep over all entries. Not differentiable in
    reverse: `mprgp` is. Source: Cottle, Pang & Stone, The Linear Complementarity Problem, 1992, section 5.2.
    """
    A, b = jnp.asarray(A), jnp.asarray(b)
    if A.ndim != 2 or A.shape != (b.shape[0], b.shape[0]):
        raise ValueError(f"A has shape {A.shape}; with b of shape {b.shape} it must be {(b.shape[0], b.shape[0])}")
    box = make_box(b, lower, upper)
    low, up = (
        jnp.full_like(b, far) if v is None else v for v, far in ((box.lower[0], -jnp.inf), (box.upper[0], jnp.inf))
    )
    diagonal = jnp.diagonal(A)

    def entry(i: Any, x: Array) -> Array:
        best = x[i] - (jnp.vdot(A[i], x, precision=jax.lax.Precision.HIGHEST) - b[i]) / diagonal[i]
        return x.at[i].set(jnp.minimum(jnp.maximum(best, low[i]), up[i]))

    def split(x: Array, g: Array) -> Array:
        projected: Array = trees.plus(*(box.split(x, g)[0], 1.0, box.split(x, g)[1]))
        return projected

    return pgs_loop(
        lambda x: jax.lax.fori_loop(0, b.shape[0], entry, x),
        lambda x: jnp.matmul(A, x, precision=jax.lax.Precision.HIGHEST) - b,
        split,
        b,
        box.clip(jnp.zeros_like(b) if x0 is None else jnp.asarray(x0, b.dtype)),
        diagonal,
        tol=tol,
        max_iterations=max_iterations,
        feasible=box.feasible(),
        weak=box.weak,
    )


def pgs_loop(
    sweep: Callable[[Any], Any],
    gradient: Callable[[Any], Any],
    projected: Callable[[Any, Any], Any],
    b: Any,
    start: Any,
    diagonal: Any,
    *,
    tol: Any,
    max_iterations: Any = None,
    feasible: Any = True,
    weak: Callable[[Any, Any, Array], Array] | None = None,
) -> tuple[Any, SolveInfo]:
    """Sweep until ||D^-1/2 projected(x, gradient(x))|| <= tol ||D^-1/2 b||. Vectors are pytrees; D is `diagonal`."""
    limit = default_limit(b) if max_iterations is None else max_iterations
    root = jax.tree.map(lambda d: jnp.where(d > 0, d, 1) ** -0.5, diagonal)
    scale = trees.norm(trees.times(root, b))
    sound = jnp.stack([jnp.all(~(d <= 0)) for d in jax.tree.leaves(diagonal)]).all()
    first = jnp.where(sound, int(Status.ITERATION_LIMIT), int(Status.NOT_POSITIVE_DEFINITE))
    first = jnp.where(feasible, first, int(Status.INFEASIBLE_BOUNDS)).astype(jnp.int32)

    def residual_of(x: Any) -> Array:
        return trees.norm(trees.times(root, projected(x, gradient(x))))

    at_start = residual_of(start)
    scale = jnp.where(scale > 0, scale, at_start)

    def judged(residual: Array, status: Array) -> Array:
        verdict = jnp.where(residual <= tol * scale, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
        verdict = jnp.where(jnp.isfinite(residual), verdict, int(Status.NOT_FINITE))
        return jnp.where(status == Status.ITERATION_LIMIT, verdict, status).astype(jnp.int32)

    def trip(carry: Any) -> Any:
        x, _, iteration, status = carry
        x = sweep(x)
        residual = residual_of(x)
        return x, residual, iteration + 1, judged(residual, status)

    def running(carry: Any) -> Array:
        more: Array = (carry[3] == Status.ITERATION_LIMIT) & (carry[2] < limit)
        return more

    begin = (start, at_start, jnp.int32(0), judged(at_start, first))
    x, residual, iteration, status = jax.lax.while_loop(running, trip, begin)
    count = jnp.int32(0)
    if weak is not None:
        precision = jnp.finfo(trees.dtype(b)).eps
        scaled = trees.times(root, gradient(x))
        count = weak(x, scaled, 10 * jnp.maximum(tol, precision) * scale)
    return x, SolveInfo(status, iteration, residual / jnp.where(scale > 0, scale, 1), count)
