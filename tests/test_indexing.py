"""Gathers and scatters by indices that fit are those of NumPy, and each other's transposes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.indexing import gather, scatter_add, with_last

RNG = np.random.default_rng(0)
PLACES = [RNG.integers(0, 7, shape).astype(np.int32) for shape in ((5,), (4, 3), (2, 3, 2))]


@pytest.mark.parametrize("index", PLACES, ids=str)
@pytest.mark.parametrize("beside", [(), (3,), (3, 2)])
def test_they_are_those_of_numpy_and_transposes_of_each_other(index, beside):
    field, values = RNG.standard_normal((7, *beside)), RNG.standard_normal((*index.shape, *beside))
    sums = np.zeros_like(field)
    np.add.at(sums, index, values)
    taken, spread = gather(jnp.asarray(field), jnp.asarray(index)), scatter_add(jnp.asarray(values), index, 7)
    np.testing.assert_array_equal(taken, field[index])
    np.testing.assert_allclose(spread, sums, rtol=1e-14, atol=1e-15)
    assert np.vdot(np.asarray(taken), values) == pytest.approx(np.vdot(field, np.asarray(spread)), rel=1e-13)


@pytest.mark.parametrize("index", PLACES, ids=str)
def test_derivatives_and_lanes_are_theirs(index):
    field, values = RNG.standard_normal((2, 7, 3)), RNG.standard_normal((2, *index.shape, 3))
    slope = jax.grad(lambda f: jnp.sum(gather(f, index) * values[0]))(jnp.asarray(field[0]))
    np.testing.assert_allclose(slope, scatter_add(jnp.asarray(values[0]), index, 7), rtol=1e-14, atol=1e-15)
    back = jax.grad(lambda v: jnp.sum(scatter_add(v, index, 7) * field[0]))(jnp.asarray(values[0]))
    np.testing.assert_array_equal(back, field[0][index])
    lanes = jax.vmap(lambda f: gather(f, index))(jnp.asarray(field))
    np.testing.assert_array_equal(lanes, field[:, index])


def test_the_last_entries_are_replaced():
    field, last = RNG.standard_normal((5, 3)), RNG.standard_normal((2, 3))
    np.testing.assert_array_equal(with_last(jnp.asarray(field), jnp.asarray(last)), np.concatenate([field[:3], last]))
