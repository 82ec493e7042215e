"""Sparse rows: operator identities, in both precisions and with a triple that occurs twice in one block."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.rows.points import PointRows

N, M, R, K = 7, 5, 3, 4


def rows_of(dtype, seed=3):
    rng = np.random.default_rng(seed)
    triples = rng.integers(0, N, (M, K))
    triples[0, 1] = triples[0, 0]
    jacobian = jnp.asarray(rng.standard_normal((M, R, 3 * K)), dtype)
    ones = jnp.ones((M, R), dtype)
    return PointRows(jnp.asarray(triples), jacobian, 1e-3 * ones, ones, unknowns=N), rng


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_apply_and_transpose_are_adjoint(dtype):
    rows, rng = rows_of(dtype)
    v, lam = jnp.asarray(rng.standard_normal((N, 3)), dtype), jnp.asarray(rng.standard_normal((M, R)), dtype)
    assert rows.apply(v).dtype == rows.apply_transpose(lam).dtype == dtype
    left, right = jnp.vdot(rows.apply(v), lam), jnp.vdot(v, rows.apply_transpose(lam))
    np.testing.assert_allclose(left, right, rtol=1e3 * jnp.finfo(dtype).eps)


def test_diagonal_is_that_of_the_operator():
    rows, rng = rows_of(jnp.float64)
    inverse_mass = jnp.asarray(rng.uniform(0.5, 2, N)).at[2].set(0.0)
    basis = jnp.eye(M * R).reshape(-1, M, R)
    columns = jax.vmap(lambda lam: rows.apply(inverse_mass[:, None] * rows.apply_transpose(lam)))(basis)
    exact = jnp.diagonal(columns.reshape(M * R, -1)).reshape(M, R)
    np.testing.assert_allclose(rows.diagonal(inverse_mass), exact, rtol=1e-12)
    assert rows.bounds is None and rows.replace(lower=-rows.bias, upper=rows.bias).bounds is not None
