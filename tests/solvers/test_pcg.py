"""Conjugate gradients: solutions, preconditioning, stopping, statuses, and cost in products."""

import box_problems
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.solvers import Status, describe, pcg

RNG = np.random.default_rng(2)
MATRIX = box_problems.spd(30, 1e3, RNG)
RIGHT = RNG.standard_normal((10, 3))


def product(x):
    return (MATRIX @ x.reshape(30)).reshape(x.shape)


@pytest.mark.parametrize("dtype, tol", [(np.float32, 1e-5), (np.float64, 1e-12)])
def test_solves_arrays_of_any_shape(dtype, tol):
    A, b = MATRIX.astype(dtype), RIGHT.astype(dtype)
    x, info = jax.jit(lambda A, b: pcg(lambda v: (A @ v.reshape(30)).reshape(10, 3), b, tol=tol))(A, b)
    assert info.status == Status.CONVERGED and x.dtype == dtype and info.residual <= tol
    expected = np.linalg.solve(MATRIX, RIGHT.ravel()).reshape(10, 3)
    assert np.max(np.abs(x - expected)) <= 1e3 * tol * np.max(np.abs(expected))


def test_preconditioner_and_warm_start():
    units = 10.0 ** RNG.uniform(-3, 3, 30)
    A, b = jnp.asarray(units[:, None] * MATRIX * units), jnp.asarray(RNG.standard_normal(30) * units)
    solve = jax.jit(lambda weights, x0: pcg(lambda v: A @ v, b, lambda r: r / weights, x0=x0, max_iterations=300))
    x, scaled = solve(jnp.diag(A), jnp.zeros(30))
    _, plain = solve(jnp.ones(30), jnp.zeros(30))
    _, warm = solve(jnp.diag(A), x)
    assert scaled.status == Status.CONVERGED and scaled.iterations < 100 and warm.iterations == 0
    assert plain.status == Status.ITERATION_LIMIT and plain.iterations == 300
    assert np.linalg.norm(A @ x - b) <= 1.1e-8 * np.linalg.norm(b)


def test_absolute_tolerance_and_zero_right_hand_side():
    b = jnp.asarray(RIGHT)
    _, strict = pcg(product, b)
    _, loose = pcg(product, b, absolute=0.1 * np.linalg.norm(RIGHT))
    assert loose.iterations < strict.iterations and loose.residual <= 0.1
    x, info = pcg(product, jnp.zeros(30))
    assert info.status == Status.CONVERGED and info.iterations == 0 and not np.any(x)


def test_one_product_a_trip():
    calls = []
    with jax.disable_jit():
        _, info = pcg(lambda x: calls.append(1) or product(x), jnp.asarray(RIGHT), tol=1e-3)
    assert info.status == Status.CONVERGED and len(calls) == info.iterations


def test_lanes_are_independent():
    rights = jnp.asarray(RNG.standard_normal((4, 30))).at[0].set(MATRIX[:, 0]).at[1].set(0.0)
    together, info = jax.jit(jax.vmap(lambda b: pcg(product, b, tol=1e-13)))(rights)
    alone = jax.jit(lambda b: pcg(product, b, tol=1e-13))
    np.testing.assert_allclose(together, [alone(b)[0] for b in rights], atol=1e-9)
    assert info.iterations[1] == 0 and info.iterations[2] > 10


def test_every_status():
    @jax.jit
    def status(entry, right, weight):
        A, b = jnp.diag(jnp.array([1.0, 2.0, 3.0])).at[1, 1].set(entry), jnp.ones(3).at[2].set(right)
        x, info = pcg(lambda v: A @ v, b, lambda r: weight * r, max_iterations=10)
        return info.status, jnp.all(jnp.isfinite(x))

    for arguments, expected in [
        ((2.0, 1.0, 1.0), Status.CONVERGED),
        ((-2.0, 1.0, 1.0), Status.NOT_POSITIVE_DEFINITE),
        ((2.0, 1.0, -1.0), Status.NOT_POSITIVE_DEFINITE),
        ((2.0, np.nan, 1.0), Status.NOT_FINITE),
        ((np.nan, 1.0, 1.0), Status.NOT_FINITE),
    ]:
        reached, finite = status(*arguments)
        assert reached == expected and finite
    _, info = pcg(product, jnp.asarray(RIGHT), max_iterations=2)
    assert info.status == Status.ITERATION_LIMIT and info.iterations == 2


def test_values_compile_nothing():
    traces = []

    @jax.jit
    def solve(b, tol, limit, absolute):
        traces.append(1)
        return pcg(product, b, tol=tol, max_iterations=limit, absolute=absolute)

    solve(RIGHT, 1e-3, 10, 0.0)
    solve(2 * RIGHT, 1e-6, 20, 1e-9)
    assert len(traces) == 1


@pytest.mark.parametrize("status", Status)
def test_each_status_is_described(status):
    assert describe(jnp.int32(status)) == describe(status) and len(describe(status)) >= len("converged")
    text = describe(np.array([0, 0, int(status)]))
    assert describe(status) in text and ("2 of 3" in text or "3 of 3" in text)
