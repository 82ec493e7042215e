"""Stabilised biconjugate gradients: systems without symmetry, their transposes, lanes, failure."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.solvers import Status
from jaxfem.solvers.bicgstab import bicgstab

RNG = np.random.default_rng(3)
MATRIX = jnp.asarray(np.eye(30) + 0.1 * RNG.normal(size=(30, 30)))
RIGHT = jnp.asarray(RNG.normal(size=30))


def solve(matrix, right):
    return bicgstab(lambda x: (matrix @ x[0],), (right,), tol=1e-11)


def test_solves_a_system_and_its_transpose():
    for matrix in (MATRIX, MATRIX.T):
        (x,), info = solve(matrix, RIGHT)
        assert info.status == Status.CONVERGED and info.residual <= 1e-11
        np.testing.assert_allclose(matrix @ x, RIGHT, atol=1e-9)


def test_the_identity_takes_one_product_and_zero_none():
    assert solve(jnp.eye(30), RIGHT)[1].iterations == 1
    (x,), info = solve(MATRIX, 0 * RIGHT)
    assert info.iterations == 0 and info.status == Status.CONVERGED and not x.any()


def test_lanes_are_what_each_is_alone():
    rights = jnp.stack([RIGHT, 0 * RIGHT, RIGHT[::-1]])
    (together,), info = jax.vmap(lambda b: solve(MATRIX, b))(rights)
    for lane, right in enumerate(rights):
        (alone,), each = solve(MATRIX, right)
        np.testing.assert_allclose(together[lane], alone, atol=1e-9)
        assert info.status[lane] == each.status == Status.CONVERGED


def test_breakdown_is_a_status():
    turn = jnp.array([[0.0, 1.0], [-1.0, 0.0]])  # b'Ab = 0
    assert bicgstab(lambda x: turn @ x, jnp.ones(2))[1].status == Status.NOT_FINITE
    assert bicgstab(lambda x: MATRIX @ x, RIGHT, tol=1e-12, max_iterations=2)[1].status == Status.ITERATION_LIMIT
