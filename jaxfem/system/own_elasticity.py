"""What a method has in place of the laws' elasticity, and whether that can be used: seen while it is traced."""

from typing import Any

import jax

from jaxfem.answers import described, is_exact
from jaxfem.model import Model, Params

Array = jax.Array


def own_elasticity(model: Model, params: Params, positions: Array, rates: Array) -> Any:
    """The method's `elasticity` at `positions` and `rates` (n, 3), None where it has none of its own.

    TypeError names the method where the answer is no energy, force and power.
    """
    found = model.method.elasticity(model, params, positions, rates)
    if found is None:
        return None
    dtype = positions.dtype
    for name, shape in (("energy", ()), ("force", positions.shape), ("power", ())):
        value = getattr(found, name, None)
        plain = type(value) is int and shape == ()  # such as 0, where nothing is stored
        if not (plain or is_exact(value, [shape], dtype)):
            given = described(found) if value is None else f"{name} = {described(value)}"
            raise TypeError(
                f'`elasticity` of the method "{model.method.name}" gives {given}; it must give an Elasticity, of '
                f"energy (), force {positions.shape} and power (), or None"
            )
    return found
