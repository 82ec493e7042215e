"""Inverses of small dense matrices: against SciPy's factorisation, in a batch, and where there is none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from jaxfem.solvers.dense import dense_inverse


def definite(size, least, seed=0):
    """A definite matrix of unit diagonal whose eigenvalues, before that scaling, go from 1 down to `least`."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(size, size)))[0]
    matrix = turn * np.geomspace(1, least, size) @ turn.T
    scale = np.diag(matrix) ** -0.5
    return matrix * scale * scale[:, None]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("size", [1, 7, 8, 33])
def test_inverse_is_as_good_as_a_factorisation(size, dtype):
    matrix = definite(size, 1e-3).astype(dtype)
    found = np.asarray(jax.jit(dense_inverse)(jnp.asarray(matrix)))
    assert found.dtype == dtype
    usual = scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), np.eye(size, dtype=dtype))

    def error(inverse):
        return np.abs(inverse.astype(np.float64) @ matrix.astype(np.float64) - np.eye(size)).max()

    assert error(found) <= 4 * error(usual) + 4 * np.finfo(dtype).eps


def test_lanes_are_inverted_alone_and_an_indefinite_one_tells():
    good, bad = definite(12, 1e-2), definite(12, 1e-2, seed=1)
    bad[7, 7] = -1e-3
    both = jax.vmap(dense_inverse)(jnp.asarray([good, bad]))
    np.testing.assert_allclose(both[0] @ good, np.eye(12), atol=1e-12)
    assert np.isnan(both[1]).all()


@pytest.mark.parametrize("diagonal", [0.0, np.nan])
def test_what_has_no_inverse_is_nan(diagonal):
    matrix = definite(9, 0.1)
    matrix[4, 4] = diagonal
    matrix[4, :4] = matrix[:4, 4] = matrix[4, 5:] = matrix[5:, 4] = 0
    found = np.asarray(dense_inverse(jnp.asarray(matrix)))
    assert np.isnan(found).any()
