"""Bodies that nothing holds: which nodes and elements are theirs."""

import jax
import numpy as np

from jaxfem.model import Model
from jaxfem.pytrees import Pytree, on_device

Array = jax.Array


class Loose(Pytree):
    """Which nodes and elements are whose: `nodes` (b, n) and `elements` (b, E + 1), 1 where they belong to a body, and
    `loose` (b, 1): 1 for bodies that nothing holds."""

    nodes: Array
    elements: Array
    loose: Array


def loose_of(model: Model, order: np.ndarray) -> Loose | None:
    """Of a model whose nodes stand in `order`; None where something holds each of its bodies."""
    if model.drifting is None:
        return None
    count, dtype = len(model.bodies), model.rest.dtype
    number = np.arange(count)[:, None]
    elements = np.asarray(model.elements.body)
    return Loose(
        on_device(np.asarray(model.node_body)[order] == number, dtype),
        on_device(np.append(elements, elements[:1]) == number, dtype),
        on_device(np.asarray(model.drifting.loose)[:count, None], dtype),
    )
