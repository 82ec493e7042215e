"""Semismooth Newton with rows beside a quadratic: optimality, stiff and redundant rows, statuses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from box_problems import spd

from jaxfem.pytrees import Pytree
from jaxfem.solvers import Status
from jaxfem.solvers.row_terms import RowTerms
from jaxfem.solvers.semismooth import minimize_with_rows

RNG = np.random.default_rng(12)
N, M = 40, 25


class Dense(Pytree):
    matrix: jax.Array

    def apply(self, velocities):
        return self.matrix @ velocities

    def apply_transpose(self, impulses):
        return self.matrix.T @ impulses


def problem(compliance, dtype=jnp.float64, repeats=1):
    """Hessian, gradient, J and slack; J's rows occur `repeats` times."""
    hessian = jnp.asarray(spd(N, 1e3, RNG), dtype)
    rows = Dense(jnp.asarray(np.repeat(RNG.normal(size=(M, N)), repeats, axis=0), dtype))
    slack = jnp.asarray(np.repeat(RNG.normal(size=M), repeats), dtype)
    return hessian, jnp.asarray(RNG.normal(size=N), dtype), rows, slack, jnp.full(slack.shape, compliance, dtype)


@jax.jit
def solve(hessian, gradient, rows, slack, compliance, lower, upper, tol, limit=10_000):
    inverse = 1 / jnp.diagonal(hessian)
    local = jnp.sum(rows.matrix**2 * inverse, axis=1)
    terms = RowTerms((slack,), (compliance,), (lower,), (upper,), (jnp.zeros_like(slack),), (local,), (None,))

    def preconditioner(stiffness):
        whole = jnp.diag(1 / inverse) + rows.matrix.T @ (stiffness[0][:, None] * rows.matrix)
        return lambda r: jnp.linalg.solve(whole, r)

    (step, impulses), info = minimize_with_rows(
        lambda x: hessian @ x, gradient, (rows,), terms, preconditioner, tol=tol, max_iterations=limit
    )
    return step, impulses, info


@pytest.mark.parametrize("compliance", [1.0, 1e-4, 1e-10, 0.0])
@pytest.mark.parametrize("dtype, tol", [(jnp.float64, 1e-10), (jnp.float32, 1e-4)])
def test_optimality_of_bounded_rows(compliance, dtype, tol):
    hessian, gradient, rows, slack, given = problem(compliance, dtype)
    low = jnp.asarray(np.where(np.arange(M) % 3 == 0, -np.inf, -0.05), dtype)
    step, (impulses,), info = solve(hessian, gradient, rows, slack, given, low, -2 * low, tol)
    assert info.status == Status.CONVERGED and step.dtype == impulses.dtype == dtype
    parts = hessian, gradient, rows.matrix, slack, given, low, step, impulses
    hessian, gradient, matrix, slack, given, low, step, impulses = map(np.asarray, parts)
    close = 1e3 * tol * np.abs(gradient).max()
    np.testing.assert_allclose(hessian @ step + gradient, matrix.T @ impulses, atol=close)
    gap = slack - matrix @ step - given * impulses
    inside = (impulses > low) & (impulses < -2 * low)
    assert 3 < int(inside.sum()) < M
    assert float(np.abs(gap[inside]).max()) < close
    assert (gap[impulses <= low] <= close).all() and (gap[impulses >= -2 * low] >= -close).all()


def test_repeated_rows_share_what_one_would_carry():
    parts = problem(0.0)
    hessian, gradient, rows, slack, given = parts
    free = jnp.full(slack.shape, jnp.inf)
    once, (single,), _ = solve(hessian, gradient, rows, slack, given, -free, free, 1e-10)
    four = (jnp.repeat(a, 4, axis=0) for a in (rows.matrix, slack, given, free))
    matrix, slack, given, free = four
    often, (shared,), info = solve(hessian, gradient, Dense(matrix), slack, given, -free, free, 1e-10)
    assert info.status == Status.CONVERGED
    np.testing.assert_allclose(often, once, atol=1e-7)
    np.testing.assert_allclose(shared.reshape(M, 4).sum(1), single, atol=1e-6)


def test_statuses():
    hessian, gradient, rows, slack, given = problem(1e-3)
    arguments = hessian, gradient, rows, slack, given, -jnp.ones(M), jnp.ones(M)
    assert solve(*arguments, 1e-9, 5)[2].status == Status.ITERATION_LIMIT
    assert solve(-hessian, *arguments[1:], 1e-9)[2].status == Status.NOT_POSITIVE_DEFINITE
    assert solve(hessian, gradient.at[0].set(jnp.nan), *arguments[2:], 1e-9)[2].status == Status.NOT_FINITE
