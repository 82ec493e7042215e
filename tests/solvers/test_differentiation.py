"""A solve with the derivative of its condition: in every mode, nested, in scans and batches; alone when not asked."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.solvers.implicit import implicit_solution


@dataclasses.dataclass(frozen=True)
class CubeRoot:
    """x + x^3 = a, entry by entry, by a loop that nobody could differentiate in reverse; `other` passes through."""

    symmetric: bool = True

    def gradient(self, inputs, unknown):
        return unknown + unknown**3 - inputs[0]

    def solve(self, inputs, guess):
        _, label = inputs
        found = jax.lax.while_loop(
            lambda x: jnp.any(jnp.abs(self.gradient(inputs, x)) > 1e-14),
            lambda x: x - self.gradient(inputs, x) / (1 + 3 * x**2),
            guess,
        )
        return found, label

    def tangent_solve(self, inputs, unknown, right, matvec):
        return right / (1 + 3 * unknown**2)


def root(value):
    return implicit_solution(CubeRoot(), (value, jnp.int32(3)), jnp.zeros_like(value))[0]


def chained(value):
    """Three roots, one of the other, and after each a scaling."""

    def one(carry, _):
        carry = 1.5 * root(carry)
        return carry, carry

    return jnp.sum(jax.lax.scan(one, value, None, length=3)[1] ** 2)


def slope(function, value, order):
    """Derivative of the given order by differences of the one before, 1e-9."""
    h = 1e-3
    before = function if order == 1 else (lambda x: slope(function, x, order - 1))
    return (8 * (before(value + h) - before(value - h)) - (before(value + 2 * h) - before(value - 2 * h))) / (12 * h)


@pytest.mark.parametrize("function", [chained, jax.checkpoint(chained)], ids=["plain", "checkpoint"])
@pytest.mark.parametrize(
    "second",
    [
        lambda f: jax.grad(jax.grad(f)),
        lambda f: jax.jacfwd(jax.jacrev(f)),
        lambda f: jax.jacrev(jax.jacfwd(f)),
        lambda f: jax.jacfwd(jax.jacfwd(f)),
    ],
    ids=["reverse over reverse", "forward over reverse", "reverse over forward", "forward over forward"],
)
def test_second_derivatives_through_a_scan(function, second):
    value = jnp.asarray(0.7)
    np.testing.assert_allclose(jax.jit(jax.grad(function))(value), slope(chained, value, 1), rtol=1e-9)
    np.testing.assert_allclose(jax.jit(second(function))(value), slope(chained, value, 2), rtol=1e-6)


def test_a_solve_that_the_inner_derivative_leaves_alone_has_its_outer_one():
    """Taking a scan apart for the inner derivative drops custom rules, and the outer one would go through the loop."""

    def inner(scale, value):
        def one(carry, _):
            found, total = carry
            found = root(1.5 * found)
            return (found, total + scale**2 * found), None

        return jax.lax.scan(one, (value, 0.0 * value), None, length=3)[0][1]

    def twice(value):
        return jax.grad(inner)(2.0, value)

    def closed(value):
        """4 times the sum of the roots."""
        total, found = 0.0, value
        for _ in range(3):
            found = root(1.5 * found)
            total = total + found
        return 4 * total

    value = jnp.asarray(0.7)
    np.testing.assert_allclose(twice(value), closed(value), rtol=1e-12)
    expected = slope(closed, value, 1)
    np.testing.assert_allclose(jax.jit(jax.grad(twice))(value), expected, rtol=1e-9)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(twice))(value), expected, rtol=1e-9)


def test_lanes_and_their_derivatives():
    values = jnp.array([[0.2, 0.7], [1.3, 4.0]])
    alone = jnp.array([[root(v) for v in row] for row in values])
    np.testing.assert_allclose(jax.vmap(jax.vmap(root))(values), alone, rtol=1e-13)
    slopes = jax.jit(jax.vmap(jax.vmap(jax.grad(root))))(values)
    np.testing.assert_allclose(slopes, 1 / (1 + 3 * alone**2), rtol=1e-12)
    np.testing.assert_allclose(jax.grad(lambda v: jnp.sum(jax.vmap(root)(v)))(values[0]), slopes[0], rtol=1e-12)
    shared = jax.vmap(lambda scale: jax.jvp(lambda v: root(scale * v), (values[0],), (values[0],))[1])(values[1])
    product = values[1][:, None] * values[0]
    np.testing.assert_allclose(shared, product / (1 + 3 * jax.vmap(jax.vmap(root))(product) ** 2), rtol=1e-12)


def test_without_a_derivative_there_is_only_the_solve():
    """No linear solve in the program, nor the condition's derivative."""
    text = jax.jit(root).lower(jnp.asarray(0.7)).as_text()
    assert "while" in text and "custom_linear_solve" not in str(jax.make_jaxpr(root)(jnp.asarray(0.7)))
    assert "linear_solve" in str(jax.make_jaxpr(jax.grad(root))(jnp.asarray(0.7)))
