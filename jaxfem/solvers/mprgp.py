"""Differentiable quadratic programs on a box: MPRGP's solution with the derivative of the optimality condition."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from jaxfem.pytrees import Pytree
from jaxfem.solvers.box import Box, make_box, where_at
from jaxfem.solvers.mprgp_iteration import mprgp_loop
from jaxfem.solvers.pcg import default_limit, pcg
from jaxfem.solvers.status import SolveInfo

__all__ = ["mprgp", "mprgp_loop"]


class _Problem(Pytree):
    """All that the solution depends on: A x is operator(x, *operands)."""

    operands: tuple[Any, ...]
    b: Array
    box: Box


class _Hints(Pytree):
    """All that only the way to the solution depends on."""

    x0: Array | None
    diagonal: Array | None
    tol: Any
    limit: Any
    gamma: Any
    step_scale: Any


def mprgp(
    A: Any,
    b: Any,
    lower: Any = None,
    upper: Any = None,
    *,
    x0: Any = None,
    tol: Any = 1e-8,
    max_iterations: Any = None,
    gamma: Any = 1.0,
    diagonal: Any = None,
    step_scale: Any = 1.6,
) -> tuple[Array, SolveInfo]:
    """Minimise 1/2 x'Ax - b'x over lower <= x <= upper, differentiably: (x, info) with x of shape (n,).

    A: symmetric positive definite, (n, n), or a linear callable x -> A x, which may close over traced values (call it
    under `jax.jit`).  b: (n,).  lower, upper: None, scalars or (n,), possibly infinite; lower == upper fixes an entry.
    x0: start (n,), projected into the box.  diagonal: (n,) of A for Jacobi scaling; taken from an array A, and no
    scaling without it for a callable.  gamma, step_scale: Gamma and alpha ||A|| of the sources.

    Stops when ||D^-1/2 g_P|| <= tol ||D^-1/2 b||, g_P the projected gradient and D the diagonal (if b = 0, relative to
    the gradient at the start); info.residual is that ratio. The number of trips, each one product with A, is at most
    max_iterations (100 + 10 n by default). tol, gamma, ... are values: changing them compiles nothing.

    jvp and vjp, of any order, with respect to A (or what the callable closes over), b, lower and upper: those of the
    reduced system A_FF dx_F = db_F - (dA x)_F - A_FB dx_B, dx_B = dlower or dupper, on the entries F strictly between
    their bounds. An entry found at a bound counts as held even where nothing presses against it: there the derivative
    is one-sided, and info.weakly_active counts such entries. With lower == upper dx_B is the mean of dlower and dupper.
    A derivative whose linear solve fails is NaN. A's entries count as independent in the derivative.

    Raises ValueError for shapes that do not fit; all else is in info.status (see `describe`).
    Source: Dostal, Optimal Quadratic Programming Algorithms, 2009; Benevolensky & Voroshilov 2009, algorithm 4;
    projected steps after Kruzik, Horak et al. 2020.
    """
    b = _vector("b", b)
    operator, operands, diagonal, dtype = _operator(A, b, diagonal)
    b = b.astype(dtype)
    n = b.shape[0]
    bounds = (_entries(name, v, n, scalar=True) for name, v in (("lower", lower), ("upper", upper)))
    x0, diagonal = (
        None if v is None else jnp.asarray(_entries(name, v, n), dtype)
        for name, v in (("x0", x0), ("diagonal", diagonal))
    )
    limit = default_limit(b) if max_iterations is None else max_iterations
    hints = _Hints(x0, diagonal, tol, limit, gamma, step_scale)
    # A callable is a new object each call: compiling here would compile each time, so that is left to the caller.
    solve = _minimum if callable(A) else _compiled
    return solve(operator, _Problem(operands, b, make_box(b, *bounds)), hints)


def _operator(A: Any, b: Array, diagonal: Any) -> tuple[Callable[..., Array], tuple[Any, ...], Any, Any]:
    if callable(A):
        # Everything closed over becomes an operand, integers too (jax.closure_convert leaves those behind): the
        # derivative rule may run after the trace that A was made in has ended.
        closed, out = jax.make_jaxpr(A, return_shape=True)(b)
        if getattr(out, "shape", None) != b.shape:
            raise ValueError(f"the operator A maps shape {b.shape} to {out}; it must keep the shape of b")
        return partial(_traced, closed.jaxpr), tuple(closed.consts), diagonal, b.dtype
    A = jnp.asarray(A)
    if A.shape != (b.shape[0], b.shape[0]):
        raise ValueError(f"A has shape {A.shape}; with b of shape {b.shape} it must be {(b.shape[0], b.shape[0])}")
    dtype = jnp.result_type(A, b)
    return _dense, (A.astype(dtype),), jnp.diagonal(A) if diagonal is None else diagonal, dtype


def _traced(jaxpr: Any, x: Array, *operands: Any) -> Array:
    product: Array = jaxpr_as_fun(ClosedJaxpr(jaxpr, operands))(x)[0]
    return product


def _dense(x: Array, A: Array) -> Array:
    return jnp.matmul(A, x, precision=jax.lax.Precision.HIGHEST)


def _vector(name: str, given: Any) -> Array:
    value: Array = jnp.asarray(given)
    if value.ndim != 1 or value.shape[0] == 0 or jnp.issubdtype(value.dtype, jnp.complexfloating):
        raise ValueError(f"{name} has shape {value.shape} and type {value.dtype}; it must be a real vector (n,), n > 0")
    return value.astype(jnp.promote_types(value.dtype, jnp.float32)) if value.dtype.kind != "f" else value


def _entries(name: str, value: Any, n: int, scalar: bool = False) -> Any:
    if value is not None and jnp.shape(value) != (n,) and not (scalar and jnp.ndim(value) == 0):
        raise ValueError(f"{name} has shape {jnp.shape(value)}; it must be ({n},){' or a scalar' if scalar else ''}")
    return value


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _minimum(operator: Callable[..., Array], problem: _Problem, hints: _Hints) -> tuple[Array, SolveInfo]:
    return mprgp_loop(
        lambda x: operator(x, *problem.operands),
        problem.b,
        problem.box.lower[0],
        problem.box.upper[0],
        x0=hints.x0,
        diagonal=hints.diagonal,
        tol=hints.tol,
        max_iterations=hints.limit,
        gamma=hints.gamma,
        step_scale=hints.step_scale,
    )


@_minimum.defjvp
def _minimum_jvp(
    operator: Callable[..., Array], primals: tuple[_Problem, _Hints], tangents: tuple[_Problem, _Hints]
) -> tuple[tuple[Array, SolveInfo], tuple[Array, SolveInfo]]:
    (problem, hints), (change, _) = primals, tangents
    x, info = _minimum(operator, problem, hints)
    return (x, info), (_tangent(operator, problem, hints, change, x), jax.tree.map(_no_tangent, info))


def _tangent(operator: Callable[..., Array], problem: _Problem, hints: _Hints, change: _Problem, x: Array) -> Array:
    """A_FF dx_F = (db - dA x - A dx_B)_F with dx_B = dlower, dupper: symmetric, so one rule gives both modes."""
    free, held = _active_set(problem.box, change.box, x)
    _, moved = jax.jvp(operator, (x, *problem.operands), (held, *change.operands))  # dA x + A dx_B
    rhs = jnp.where(free, change.b - moved, 0)

    def masked(v: Array) -> Array:
        return jnp.where(free, operator(jnp.where(free, v, 0), *problem.operands), v)

    dx = jax.lax.custom_linear_solve(masked, rhs, partial(_solve_tangent, hints, free), symmetric=True)
    return jnp.where(free, dx, held)


def _active_set(box: Box, change: Box, x: Array) -> tuple[Array, Array]:
    """Mask of the free entries, and the others' motion with their bounds."""
    if not box.bounded:
        return jnp.ones(x.shape, bool), jnp.zeros_like(x)
    low, up, dlow, dup = (jnp.asarray(side[0]) for side in (box.lower, box.upper, change.lower, change.upper))
    at_low, at_up, free = where_at(low, up, x)
    both = jnp.where(free, 0, 0.5 * (dlow + dup))
    return free, jnp.where(at_low, dlow, jnp.where(at_up, dup, both))


def _solve_tangent(hints: _Hints, free: Array, matvec: Callable[[Array], Array], rhs: Array) -> Array:
    diagonal = 1.0 if hints.diagonal is None else jax.lax.stop_gradient(hints.diagonal)
    weights = jnp.where(free, diagonal, 1)
    x, info = pcg(matvec, rhs, lambda r: r / weights, tol=hints.tol, max_iterations=hints.limit)
    # No info leaves a derivative, so a wrong one must be seen to be wrong.
    return jnp.where(info.residual <= jnp.sqrt(hints.tol), x, jnp.nan)


def _no_tangent(value: Array) -> Any:
    is_real = jnp.issubdtype(value.dtype, jnp.floating)
    return jnp.zeros_like(value) if is_real else np.zeros(value.shape, jax.dtypes.float0)


_compiled = jax.jit(_minimum, static_argnums=0)
