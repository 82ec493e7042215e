"""One check for every derivative: forward = reverse = central differences, in scalar arguments."""

import jax
import jax.numpy as jnp
import numpy as np


class Parted:
    """`function(*values)` and its derivatives by a program each: the run, its slopes forwards, and backwards.

    In one program they take longer: compiling takes more than in proportion to a program's kernels. The run is solved
    once for all of them, and once for each value of a difference. With `has_aux` the function gives (value, aux).
    """

    def __init__(self, function, has_aux=False):
        self._has_aux = has_aux
        self._run = jax.jit(lambda *values: jax.linearize(function, *values, has_aux=has_aux))
        self._forwards = jax.jit(lambda push, direction: push(*direction))
        # In a function of its own: JAX names what it transposes by its text, which is the whole program's.
        self._backwards = jax.jit(
            lambda push, values, weight: jax.linear_transpose(lambda *steps: push(*steps), *values)(weight)
        )

    def __call__(self, *values):
        """What the function gives."""
        value, _, *aux = self._run(*_arrays(values))
        return (value, *aux) if self._has_aux else value

    def forwards(self, *values, direction):
        """The derivative along `direction`."""
        return self._forwards(self._run(*_arrays(values))[1], _arrays(direction))

    def backwards(self, *values, weight=None):
        """Gradients of a scalar, or of the sum of `weight` times what the function gives: one for each value."""
        values = _arrays(values)
        value, push, *_ = self._run(*values)
        return self._backwards(push, values, jnp.ones_like(value) if weight is None else weight)


def _arrays(values):
    """As arrays of a type of their own: a number of Python's would be compiled for once more."""
    return jax.tree.map(lambda value: jnp.asarray(value, jnp.result_type(value)), tuple(values))


def check(loss, values, rtol=1e-6, h=1e-4, agree=1e-8, has_aux=False, forwards=True):
    """Derivatives of `loss(*values)` in scalars: vjp = fourth-order differences to rtol, jvp = vjp to `agree`.

    Returns the loss as its program gives it, for more values: see Parted, and there for `has_aux`. Both ways go by one
    rule: without `forwards` a third of the time is saved, where another test takes the same method forwards.
    """
    values = tuple(jnp.asarray(v, float) for v in values)
    parted = Parted(loss, has_aux)
    slopes = parted.backwards(*values)
    if forwards:
        direction = tuple(jnp.asarray(v) for v in np.random.default_rng(0).uniform(0.5, 1.5, len(values)))
        along = sum(s * d for s, d in zip(slopes, direction, strict=True))
        np.testing.assert_allclose(parted.forwards(*values, direction=direction), along, rtol=agree)

    def at(i, k):
        found = parted(*(v + k * h * (i == j) for j, v in enumerate(values)))
        return float(found[0] if has_aux else found)

    for i, slope in enumerate(slopes):
        central = (8 * (at(i, 1) - at(i, -1)) - (at(i, 2) - at(i, -2))) / (12 * h)
        assert abs(slope) > 1e-8
        np.testing.assert_allclose(central, slope, rtol=rtol)
    return parted
