"""Few rows by elimination of their whole matrix."""

from collections import OrderedDict

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.methods.allrows.dense import by_elimination


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_a_matrix_without_symmetry_that_is_nearly_singular_is_solved(dtype):
    random = np.random.default_rng(0)
    matrix = np.eye(12) + 0.3 * random.standard_normal((12, 12))
    matrix[5] = matrix[4] + (1e-9 if dtype == jnp.float64 else 1e-4) * random.standard_normal(12)
    known = random.standard_normal(12)
    dense = jnp.asarray(matrix, dtype)

    def parted(flat):
        return OrderedDict(a=flat[:6].reshape(2, 3), b=flat[6:].reshape(6, 1))

    def product(rows):
        return parted(dense @ jnp.concatenate([leaf.ravel() for leaf in rows.values()]))

    right = product(parted(jnp.asarray(known, dtype)))
    weights = parted(jnp.abs(jnp.diag(dense)) + 0.1)
    found, info = jax.jit(lambda right: by_elimination(product, right, weights))(right)
    exact = np.linalg.solve(matrix, np.concatenate([np.ravel(leaf) for leaf in right.values()]).astype(float))
    np.testing.assert_allclose(
        np.concatenate([np.ravel(leaf) for leaf in found.values()]), exact, atol=1e-5 if dtype == jnp.float64 else 3e-2
    )
    assert float(info.residual) < 1e-12 if dtype == jnp.float64 else 1e-5
