"""Anderson acceleration: a linear map at rest in as many steps as it has directions; sound where it cannot help."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.solvers.anderson import DEPTH, accelerated, empty

RNG = np.random.default_rng(5)


def linear(rates):
    """x -> A x + c with eigenvalues `rates`, on a pair of blocks; and its fixed point."""
    size = len(rates)
    basis = RNG.normal(size=(size, size))
    matrix = jnp.asarray(basis @ np.diag(rates) @ np.linalg.inv(basis))
    shift = jnp.asarray(RNG.normal(size=size))
    answer = jnp.linalg.solve(jnp.eye(size) - matrix, shift)

    def split(x):
        return x[:2].reshape(2, 1), x[2:]

    def image(pair):
        return split(matrix @ jnp.concatenate([pair[0].ravel(), pair[1]]) + shift)

    return image, split(answer), split(jnp.zeros(size)), split(jnp.ones(size))


def off(pair, answer):
    return max(float(jnp.abs(a - b).max()) for a, b in zip(pair, answer, strict=True))


def test_a_linear_map_comes_to_rest_once_all_its_directions_are_known():
    image, answer, x, weights = linear([0.98, -0.9, 0.97, 0.5, 1.3])
    history = empty(x)
    for _ in range(DEPTH + 1):
        x, history = accelerated(history, x, image(x), weights)
    assert int(history.count) == DEPTH
    assert off(x, answer) < 1e-5 * max(float(jnp.abs(leaf).max()) for leaf in answer)


def test_first_step_is_the_plain_one_and_weights_change_later_ones():
    image, _, x, weights = linear([0.9, 0.8, 0.7, 0.6, 0.5])
    first, history = accelerated(empty(x), x, image(x), weights)
    assert off(first, image(x)) == 0
    plain, _ = accelerated(history, first, image(first), weights)
    other, _ = accelerated(history, first, image(first), (100 * weights[0], weights[1]))
    assert off(plain, image(first)) > 1e-3 and off(plain, other) > 1e-3


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_steps_that_depend_on_each_other_stay_finite(dtype):
    x = (jnp.ones(3, dtype),)
    history = empty(x)
    for _ in range(2 * DEPTH):
        x, history = accelerated(history, x, (0.5 * x[0],), (jnp.ones(3, dtype),))
        assert x[0].dtype == dtype and jnp.isfinite(x[0]).all()
    assert float(jnp.abs(x[0]).max()) < 1e-6
