"""MPRGP's derivatives: forward = reverse = central differences, of first and second order, and where they end."""

import box_problems
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.solvers import mprgp

PROBLEM = box_problems.random_box(12, 50.0, 4)
RNG = np.random.default_rng(11)
WEIGHTS = RNG.standard_normal(12)
PRECISE = 1e-13


def by_array(inputs):
    """From an array A; the two bounds of a fixed entry move together."""
    fixed = PROBLEM.lower == PROBLEM.upper
    upper = jnp.where(fixed, inputs["lower"], inputs["upper"])
    return mprgp(inputs["A"], inputs["b"], inputs["lower"], upper, tol=PRECISE)[0]


def by_callable(inputs):
    """From a callable that closes over traced floats and over integers."""
    order = jnp.arange(12)[::-1]

    def operator(x):
        return inputs["A"] @ x + inputs["stiffness"] ** 2 * x[order][order]

    return mprgp(operator, inputs["b"], inputs["lower"], inputs["upper"], tol=PRECISE, max_iterations=500)[0]


INPUTS = {"A": PROBLEM.A, "b": PROBLEM.b, "lower": PROBLEM.lower, "upper": PROBLEM.upper, "stiffness": np.array(0.7)}


def direction(name):
    """Random motion of one input alone, A staying symmetric and infinite bounds where they are."""
    change = {key: np.zeros_like(value) for key, value in INPUTS.items()}
    move = RNG.standard_normal(INPUTS[name].shape)
    move = move + move.T if name == "A" else move
    change[name] = np.where(np.isfinite(INPUTS[name]), move, 0.0)
    return change


@pytest.fixture(scope="module", params=[by_array, by_callable])
def derivatives(request):
    """Compiled once for all inputs: the solution, its forward and its reverse derivative."""
    solve = request.param
    forward = jax.jit(lambda i, di: jax.jvp(solve, (i,), (di,))[1])
    reverse = jax.jit(lambda i, c: jax.vjp(solve, i)[1](c)[0])
    return solve, jax.jit(solve), forward, reverse


@pytest.mark.parametrize("name", INPUTS)
def test_forward_reverse_and_differences_agree(derivatives, name):
    solve, value, forward, reverse = derivatives
    if name == "stiffness" and solve is by_array:
        return
    change = direction(name)
    if name in ("lower", "upper") and solve is by_callable:  # an entry fixed by equal bounds keeps them equal
        change[name] = np.where(PROBLEM.lower == PROBLEM.upper, 0.0, change[name])
    step = 1e-5
    ahead, behind = (value(jax.tree.map(lambda v, d, s=s: v + s * d, INPUTS, change)) for s in (step, -step))
    tangent = forward(INPUTS, change)
    assert np.max(np.abs(tangent)) > 1e-3
    np.testing.assert_allclose(tangent, (ahead - behind) / (2 * step), atol=2e-8)
    cotangent = reverse(INPUTS, WEIGHTS)
    paired = sum(np.sum(cotangent[key] * change[key]) for key in INPUTS)
    assert paired == pytest.approx(float(WEIGHTS @ tangent), rel=1e-9)


def test_equal_bounds_share_the_derivative():
    fixed = np.flatnonzero(PROBLEM.lower == PROBLEM.upper)[0]
    slope = jax.grad(lambda lower: mprgp(PROBLEM.A, PROBLEM.b, lower, PROBLEM.upper)[0][fixed])
    gradient = jax.jit(slope)(PROBLEM.lower)
    np.testing.assert_allclose(gradient, 0.5 * (np.arange(12) == fixed))


def test_second_derivatives():
    inputs = {key: jnp.asarray(value) for key, value in INPUTS.items()}
    change = jax.tree.map(jnp.add, direction("b"), direction("stiffness"))
    gradient = jax.jit(jax.grad(lambda i: jnp.sum(WEIGHTS * by_callable(i) ** 3)))
    hvp = jax.jit(lambda i, d: jax.jvp(gradient, (i,), (d,))[1])(inputs, change)
    step = 1e-5
    ahead, behind = (gradient(jax.tree.map(lambda v, d, s=s: v + s * d, inputs, change)) for s in (step, -step))
    for key in ("b", "stiffness", "A"):
        expected = (ahead[key] - behind[key]) / (2 * step)
        np.testing.assert_allclose(hvp[key], expected, atol=1e-6 * np.max(np.abs(expected)) + 1e-7)


def test_batched_derivatives_with_lanes_of_integers():
    """vmap of grad, the callable closing over a lane's integers and floats."""
    orders = jnp.stack([jnp.arange(12), jnp.roll(jnp.arange(12), 5)])
    stiffness = jnp.array([0.5, 2.0])

    @jax.jit
    def loss(k, order):
        x, _ = mprgp(
            lambda x: PROBLEM.A @ x + k * jnp.zeros(12).at[order].add(x[order]), PROBLEM.b, -0.1, 0.2, tol=1e-12
        )
        return x @ WEIGHTS

    together = jax.jit(jax.vmap(jax.grad(loss)))(stiffness, orders)
    k, h = 0.5, 1e-5
    assert together[0] == pytest.approx(float(loss(k + h, orders[0]) - loss(k - h, orders[0])) / (2 * h), rel=1e-6)
    assert np.all(np.isfinite(together)) and together[0] != together[1]


def test_weakly_active_entry_is_flagged_and_held():
    A, lower = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([1.0, -5.0])
    b = A @ np.array([1.0, 2.0])  # the free minimum lies exactly on the first bound
    x, info = mprgp(A, b, lower, x0=np.array([0.0, 1.0]), tol=1e-12)
    np.testing.assert_allclose(x, [1.0, 2.0], atol=1e-10)
    assert info.weakly_active == 1
    _, strict = mprgp(A, b - np.array([0.1, 0.0]), lower, tol=1e-12)
    assert strict.weakly_active == 0
    tangent = jax.jvp(lambda b: mprgp(A, b, lower, x0=np.array([1.0, 2.0]))[0], (b,), (np.array([1.0, 1.0]),))[1]
    np.testing.assert_allclose(tangent, [0.0, 1.0])


def test_failed_derivative_is_nan():
    gradient = jax.jit(jax.grad(lambda b: mprgp(PROBLEM.A, b, max_iterations=2)[0] @ WEIGHTS))(PROBLEM.b)
    assert np.all(np.isnan(gradient))
