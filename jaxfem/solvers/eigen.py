"""Lowest eigenpairs of K x = lambda M x: locally optimal block preconditioned conjugate gradients (Knyazev 2001)."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree

Array = jax.Array
Operator = Callable[[Array], Array]


class EigenResult(Pytree):
    """`values` (m,) ascending, `vectors` (m, d) with x'Mx = 1, their relative `errors` (m,), and `iterations`."""

    values: Array
    vectors: Array
    errors: Array
    iterations: Array


class _State(Pytree):
    vectors: Array
    previous: Array
    errors: Array
    iteration: Array


def lowest_eigenpairs(
    stiffness: Operator,
    mass: Operator,
    precondition: Operator,
    start: Array,
    count: int,
    *,
    shift: Any,
    largest: Any,
    tol: Any,
    max_iterations: Any = 300,
) -> EigenResult:
    """The lowest eigenpairs, from a block `start` (m, d) of which the first `count` have to converge.

    The operators take blocks (k, d). `precondition`: roughly (K + shift M)^-1, symmetric positive definite; K itself
    may be singular or indefinite. A pair is good when its residual r has (r'Tr)^1/2 <= tol (|lambda| + shift)^1/2, T
    the preconditioner: about the error of the vector, whose square is that of the value. Below what rounding makes of
    it, told from the `largest` eigenvalue (an estimate), it counts as 0. The m - count further vectors make it fast
    and keep repeated values together. Batched with vmap; no derivative rule.
    """
    width = start.shape[0]

    def measured(x: Array, kx: Array, mx: Array) -> tuple[Array, Array, Array]:
        values = jnp.sum(x * kx, axis=1)
        residual = kx - values[:, None] * mx
        corrections = precondition(residual)
        size = jnp.abs(values) + shift
        errors = jnp.sqrt(jnp.abs(jnp.sum(residual * corrections, axis=1)) / size)
        errors = jnp.maximum(errors - _rounding(size, largest, x), 0)
        # A vector that vanished (more asked for than there are) is no mode.
        return values, jnp.where(jnp.sum(x * mx, axis=1) < 0.5, jnp.inf, errors), corrections

    def running(s: _State) -> Array:
        more: Array = jnp.any(s.errors[:count] > tol) & (s.iteration < max_iterations)
        return more

    def trip(s: _State) -> _State:
        x, kx, mx = s.vectors, stiffness(s.vectors), mass(s.vectors)
        _, errors, w = measured(x, kx, mx)
        w, p = (v - (v @ mx.T) @ x for v in (w, s.previous))
        basis = jnp.concatenate([x, w, p])
        k_basis = jnp.concatenate([kx, stiffness(w), stiffness(p)])
        m_basis = jnp.concatenate([mx, mass(w), mass(p)])
        c = _ritz(basis @ k_basis.T, basis @ m_basis.T)[1][:, :width]
        moved = c.at[:width].set(0)
        return _State(c.T @ basis, moved.T @ basis, errors, s.iteration + 1)

    c = _ritz(start @ stiffness(start).T, start @ mass(start).T)[1]
    unknown = jnp.full(width, jnp.inf, start.dtype)
    end = jax.lax.while_loop(running, trip, _State(c.T @ start, jnp.zeros_like(start), unknown, jnp.int32(0)))
    values, errors, _ = measured(end.vectors, stiffness(end.vectors), mass(end.vectors))
    return EigenResult(values, end.vectors, errors, end.iteration)


def _rounding(size: Array, largest: Array, vectors: Array) -> Array:
    """Error (m,) that rounding leaves in `vectors` (m, d) of shifted values `size` (m,)."""
    # K x is off by about eps largest |x|, evenly over all vectors: T weighs rough ones by 1 / largest, and the few
    # softest, a share 1 / d, by 1 / their size. Past 0.05 even the value is no longer worth much.
    noise = 4 * jnp.sqrt(largest / size) + 8 * largest / jnp.sqrt(size * jnp.min(size) * vectors.shape[1])
    return jnp.minimum(jnp.finfo(vectors.dtype).eps * noise, 0.05)


def _ritz(stiffness: Array, mass: Array) -> tuple[Array, Array]:
    """Eigenpairs (k,), (k, k) of small symmetric matrices; directions that depend on others come last, as zeros.

    Stathopoulos & Wu 2002: scaled to a unit diagonal, then the mass matrix's own eigenvectors.
    """
    diagonal = jnp.diagonal(mass)
    scale = jnp.where(diagonal > 0, 1 / jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1)), 0)
    sizes, turn = jnp.linalg.eigh(_symmetric(mass * scale[:, None] * scale))
    kept = sizes > 30 * jnp.finfo(mass.dtype).eps * sizes[-1]
    to = scale[:, None] * turn * jnp.where(kept, 1 / jnp.sqrt(jnp.where(kept, sizes, 1)), 0)
    small = _symmetric(to.T @ stiffness @ to)
    high = 10 * (1 + jnp.abs(small).sum())
    values, vectors = jnp.linalg.eigh(small + jnp.diag(jnp.where(kept, 0, high)))
    return values, to @ vectors


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2
