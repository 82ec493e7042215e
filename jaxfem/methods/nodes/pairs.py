"""Values of the first and the second node of each pair of a domain's nodes, side by side."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

Array = jax.Array


def firsts(values: Array, slots: Sequence[Array]) -> Array:
    """What the first node of each pair of a domain's nodes has, (k, Q), of `values` (m, k, D).

    Pairs in the order of `slots`: by their second node b, then by the first a < b, then by those domains that have a
    node b, so that no work is spent on padding.
    """
    parts = [jnp.swapaxes(values[:b, :, : each.shape[1]], 0, 1) for b, each in enumerate(slots, start=1)]
    return jnp.concatenate([part.reshape(len(part), -1) for part in parts], 1)


def seconds(values: Array, slots: Sequence[Array]) -> Array:
    """What the second node of each pair has, (k, Q); see `firsts`."""
    parts = [
        jnp.broadcast_to(values[b, :, None, : each.shape[1]], (values.shape[1], *each.shape))
        for b, each in enumerate(slots, start=1)
    ]
    return jnp.concatenate([part.reshape(len(part), -1) for part in parts], 1)
