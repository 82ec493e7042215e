"""One check for every derivative: forward = reverse = central differences, in scalar arguments."""

import jax
import jax.numpy as jnp
import numpy as np


def check(loss, values, rtol=1e-6, h=1e-4):
    """Derivatives of `loss(*values)` in scalars: vjp = fourth-order differences to rtol, jvp = vjp to 1e-8."""
    values = tuple(jnp.asarray(v, float) for v in values)
    direction = tuple(jnp.asarray(v) for v in np.random.default_rng(0).uniform(0.5, 1.5, len(values)))
    value_and_slopes = jax.jit(jax.value_and_grad(loss, argnums=tuple(range(len(values)))))
    slopes = value_and_slopes(*values)[1]
    forward = jax.jit(lambda *v: jax.jvp(loss, v, direction)[1])(*values)
    np.testing.assert_allclose(forward, sum(s * d for s, d in zip(slopes, direction, strict=True)), rtol=1e-8)
    for i, slope in enumerate(slopes):
        at = {
            k: float(value_and_slopes(*(v + k * h * (i == j) for j, v in enumerate(values)))[0]) for k in (-2, -1, 1, 2)
        }
        central = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h)
        assert abs(slope) > 1e-8
        np.testing.assert_allclose(central, slope, rtol=rtol)
