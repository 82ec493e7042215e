"""One check for every derivative: forward = reverse = central differences, in scalar arguments."""

import jax
import jax.numpy as jnp
import numpy as np


def with_slopes(loss, *values, direction):
    """Value, derivative along `direction` and gradient of `loss(*values)`; in one program, which solves once."""
    value, push = jax.linearize(loss, *values)
    pull = jax.linear_transpose(push, *values)
    return value, push(*direction), pull(jnp.ones_like(value))


def check(loss, values, rtol=1e-6, h=1e-4):
    """Derivatives of `loss(*values)` in scalars: vjp = fourth-order differences to rtol, jvp = vjp to 1e-8."""
    values = tuple(jnp.asarray(v, float) for v in values)
    direction = tuple(jnp.asarray(v) for v in np.random.default_rng(0).uniform(0.5, 1.5, len(values)))
    everything = jax.jit(lambda *v: with_slopes(loss, *v, direction=direction))
    _, forward, slopes = everything(*values)
    np.testing.assert_allclose(forward, sum(s * d for s, d in zip(slopes, direction, strict=True)), rtol=1e-8)
    for i, slope in enumerate(slopes):
        at = {k: float(everything(*(v + k * h * (i == j) for j, v in enumerate(values)))[0]) for k in (-2, -1, 1, 2)}
        central = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h)
        assert abs(slope) > 1e-8
        np.testing.assert_allclose(central, slope, rtol=rtol)
