"""One check for every derivative: forward = reverse = central differences, in scalar arguments."""

import jax
import jax.numpy as jnp
import numpy as np


def check(loss, values, rtol=1e-6, h=1e-4):
    """Derivatives of `loss(*values)` in each of the scalars: jvp = vjp to 1e-8, differences of fourth order to rtol."""
    values = tuple(jnp.asarray(v, float) for v in values)
    places = tuple(range(len(values)))
    loss, run = jax.jit(loss), loss
    reverse = jax.jit(jax.grad(run, argnums=places))(*values)
    forward = jax.jit(jax.jacfwd(run, argnums=places))(*values)
    for i in places:
        at = {k: float(loss(*(v + k * h * (i == j) for j, v in enumerate(values)))) for k in (-2, -1, 1, 2)}
        central = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * h)
        assert abs(reverse[i]) > 1e-8
        np.testing.assert_allclose(forward[i], reverse[i], rtol=1e-8)
        np.testing.assert_allclose(central, reverse[i], rtol=rtol)
