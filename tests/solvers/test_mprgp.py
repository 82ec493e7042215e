"""MPRGP: solutions against outside values and optimality, batching, statuses, and cost in products."""

import importlib

import box_problems
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.solvers import Status, mprgp, mprgp_iteration, pcg
from jaxfem.solvers.mprgp import mprgp_loop

NUMBERS = ["01", "03", "06", "11", "14", "16", "20"]


@jax.jit
def solve_and_pull_back(A, b, lower, upper, cotangent):
    x, pullback, info = jax.vjp(lambda b: mprgp(A, b, lower, upper, tol=1e-11), b, has_aux=True)
    return x, info, pullback(cotangent)[0]


@pytest.mark.parametrize("number", NUMBERS)
def test_reference_solution_and_derivative(reference, number):
    problem, file = box_problems.from_file(reference / f"boxqp_{number}.npz")

    x, info, vjp = solve_and_pull_back(*problem, file.get("g", np.zeros_like(problem.b)))
    assert info.status == Status.CONVERGED
    assert np.max(np.abs(x - file["x"])) <= 1e-8 * np.max(np.abs(file["x"]))
    assert box_problems.kkt_residual(problem, x) <= 1.01e-11
    if number == "16":  # weakly active throughout: no derivative to compare
        assert info.weakly_active == x.size
        return
    assert info.weakly_active == 0
    np.testing.assert_array_equal((x <= problem.lower) | (x >= problem.upper), file["act"] != 0)
    assert np.max(np.abs(vjp - file["vjp"])) <= 1e-6 * np.max(np.abs(file["vjp"]))


@pytest.mark.parametrize("dtype, tol", [(np.float32, 1e-5), (np.float64, 1e-10)])
@pytest.mark.parametrize("name", box_problems.TABLE)
def test_table(name, dtype, tol):
    problem = box_problems.BoxProblem(*(v.astype(dtype) for v in box_problems.TABLE[name]))
    x, info = mprgp(*problem, tol=tol)
    assert info.status == Status.CONVERGED and x.dtype == dtype and info.residual.dtype == dtype
    # What is reported is what is there, up to the rounding of a product in this precision.
    size = np.abs(problem.A) @ np.abs(x) / np.sqrt(np.diag(problem.A))
    rounding = np.finfo(dtype).eps * np.linalg.norm(size) / np.linalg.norm(problem.b / np.sqrt(np.diag(problem.A)))
    assert abs(box_problems.kkt_residual(problem, x) - info.residual) <= 5 * rounding + 1e-3 * tol


def test_two_thousand_rows():
    problem = box_problems.random_box(2000, 1e4, 7)
    x, info = mprgp(*problem, tol=1e-8)
    assert info.status == Status.CONVERGED and box_problems.kkt_residual(problem, x) <= 1.01e-8
    assert 200 < np.sum((x <= problem.lower) | (x >= problem.upper)) < 1800
    assert info.iterations < 1000


def test_lanes_are_independent():
    problems = [box_problems.random_box(24, 10.0 ** (1 + seed % 5), seed) for seed in range(32)]
    lanes = [jnp.stack(field) for field in zip(*problems, strict=True)]
    together, info = jax.vmap(mprgp)(*lanes)
    alone, alone_info = zip(*(mprgp(*problem) for problem in problems), strict=True)
    assert np.all(info.status == Status.CONVERGED) and np.ptp(info.iterations) > 10
    np.testing.assert_allclose(together, np.stack(alone), rtol=0, atol=1e-9)
    np.testing.assert_allclose(info.iterations, [i.iterations for i in alone_info], atol=2)
    # A lane that has finished stays as it is while the others go on.
    starts = jnp.zeros_like(together).at[0].set(together[0])
    again, info = jax.vmap(lambda *lane: mprgp(*lane[:4], x0=lane[4]))(*lanes, starts)
    assert info.iterations[0] <= 2 and np.max(info.iterations) > 20
    np.testing.assert_allclose(again[0], together[0], rtol=1e-15, atol=0)


def test_warm_start_and_start_outside():
    problem = box_problems.TABLE["box"]
    x, cold = mprgp(*problem, tol=1e-9)
    _, warm = mprgp(*problem, x0=x, tol=1e-9)
    assert warm.status == Status.CONVERGED and warm.iterations <= 2 < cold.iterations
    y, info = mprgp(*problem, x0=np.full(60, 1e3), tol=1e-9)
    assert info.status == Status.CONVERGED and np.max(np.abs(x - y)) < 1e-7


def test_one_product_a_trip():
    A, b, lower, upper = box_problems.random_box(12, 30.0, 6)
    calls = []

    def product(x):
        calls.append(1)
        return A @ x

    with jax.disable_jit():
        _, info = mprgp_loop(product, jnp.asarray(b), lower, upper, diagonal=jnp.diag(A), tol=1e-3)
        assert info.status == Status.CONVERGED and len(calls) == info.iterations
        calls.clear()
        _, info = mprgp_loop(product, jnp.asarray(b), None, None, diagonal=jnp.diag(A), tol=1e-2)
        assert info.status == Status.CONVERGED and len(calls) == info.iterations


@pytest.mark.parametrize("every", [False, True])
def test_fallback_steps_converge(monkeypatch, every):
    """Each rise undone by a short step; or short steps alone, whose norm is found on the way."""
    monkeypatch.setattr(mprgp_iteration, "RISES_ALLOWED", 0)
    if every:
        rises = mprgp_iteration._rises
        monkeypatch.setattr(mprgp_iteration, "_rises", lambda s, c, ww: (~s.short & (ww > 0)) | rises(s, c, ww))
    problem = box_problems.TABLE["box"]
    solve = jax.jit(lambda A, *rest: mprgp_loop(lambda x: A @ x, *rest, diagonal=jnp.diag(A), max_iterations=5000))
    x, info = solve(*problem)
    assert info.status == Status.CONVERGED and box_problems.kkt_residual(problem, x) <= 1.01e-8


def test_blocks_without_bounds():
    """Rows in blocks of different shapes, one of them unbounded, are the flat problem."""
    A, b, _, _ = box_problems.TABLE["box"]
    upper = np.r_[np.full(36, np.inf), np.full(24, 0.3)]

    def blocks(x):
        return (x[:36].reshape(6, 6), x[36:].reshape(8, 3))

    def operator(x):
        return blocks(A @ jnp.concatenate([v.ravel() for v in x]))

    solve = jax.jit(
        lambda b, diagonal, upper: mprgp_loop(operator, b, (None, -0.2), (None, upper), diagonal=diagonal, tol=1e-10)
    )
    parts, info = solve(blocks(b), blocks(np.diag(A)), blocks(upper)[1])
    flat, flat_info = mprgp(A, b, np.r_[np.full(36, -np.inf), np.full(24, -0.2)], upper, tol=1e-10)
    assert info.iterations == flat_info.iterations
    np.testing.assert_allclose(np.concatenate([v.ravel() for v in parts]), flat, atol=1e-12)


def test_no_bounds_is_conjugate_gradients():
    A, b, _, _ = box_problems.TABLE["box"]
    x, info = mprgp(A, b)
    scale = np.diag(A) ** -0.5
    y, cg = pcg(lambda v: scale * (A @ (scale * v)), jnp.asarray(scale * b))
    assert info.status == Status.CONVERGED and info.iterations == cg.iterations
    np.testing.assert_allclose(x, scale * y, atol=1e-7)


def test_small_and_degenerate():
    identity = np.eye(2)
    x, info = mprgp(identity, np.zeros(2), lower=np.array([1.0, -1.0]))  # b = 0, and the box excludes 0
    assert info.status == Status.CONVERGED and np.array_equal(x, [1.0, 0.0])
    x, info = mprgp(identity, np.array([3, -4]), 0.5, 0.5)  # everything fixed; integer b
    assert info.status == Status.CONVERGED and np.array_equal(x, [0.5, 0.5]) and info.weakly_active == 0
    x, info = mprgp(2 * identity, np.array([2.0, 1.0]), upper=1.0)  # the first entry just reaches its bound
    assert info.status == Status.CONVERGED and info.weakly_active == 1
    np.testing.assert_allclose(x, [1.0, 0.5])


STATUSES = {
    "converged": ({}, Status.CONVERGED),
    "limit": ({"limit": 2}, Status.ITERATION_LIMIT),
    "nan in b": ({"b": np.nan}, Status.NOT_FINITE),
    "infinite A": ({"A": np.inf}, Status.NOT_FINITE),
    "negative curvature": ({"A": -2.8}, Status.NOT_POSITIVE_DEFINITE),
    "negative diagonal": ({"diagonal": -1.0}, Status.NOT_POSITIVE_DEFINITE),
    "crossed bounds": ({"lower": 10.0}, Status.INFEASIBLE_BOUNDS),
    "nan bound": ({"lower": np.nan}, Status.INFEASIBLE_BOUNDS),
}


@pytest.mark.parametrize("case", STATUSES)
def test_every_status(case):
    change, expected = STATUSES[case]
    A, b = np.diag([1.0, 2.0, 3.0]) + 0.1, np.ones(3)
    A[0, 1] = A[1, 0] = change.get("A", A[0, 1])
    A[2, 2] *= change.get("diagonal", 1.0)
    b[1] *= change.get("b", 1.0)
    lower = np.array([-9.0, change.get("lower", 0.0), 0.0])
    x, info = mprgp(A, b, lower, np.array([9.0, 9.0, 9.0]), max_iterations=change.get("limit", 50))
    assert info.status == expected
    if case not in ("nan bound", "crossed bounds"):
        assert np.all(np.isfinite(x))


def test_values_compile_nothing(monkeypatch):
    module = importlib.import_module("jaxfem.solvers.mprgp")
    traces = []
    monkeypatch.setattr(module, "mprgp_loop", lambda *a, **k: traces.append(1) or mprgp_loop(*a, **k))
    A, b, lower, upper = box_problems.random_box(17, 10.0, 3)  # a size that no other test compiles
    for scale in (1.0, 2.0):
        mprgp(scale * A, scale * b, lower, scale * upper, tol=1e-6 * scale, gamma=scale, step_scale=1.6 / scale)
        mprgp(A, b, lower - scale, upper, tol=1e-6 * scale, gamma=scale, max_iterations=int(100 * scale))
    assert len(traces) <= 2  # one for each set of given arguments, whatever their values


@pytest.mark.parametrize("name", box_problems.TABLE)
def test_table_is_symmetric(name):
    A = box_problems.TABLE[name].A
    u, v = np.random.default_rng(0).standard_normal((2, len(A)))
    assert u @ (A @ v) == pytest.approx(v @ (A @ u), rel=1e-10)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((np.eye(3), np.ones((3, 1))), "b has shape"),
        ((np.eye(3), np.ones(2)), "A has shape"),
        ((np.eye(3), np.ones(3), np.zeros(2)), "lower has shape"),
        ((np.eye(3), np.ones(3), None, np.zeros((3, 3))), "upper has shape"),
        ((lambda x: x[:2], np.ones(3)), "operator A maps"),
        ((np.eye(3), np.ones(3) * 1j), "real vector"),
    ],
)
def test_misfits_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        mprgp(*arguments)
