"""Derivatives of outputs in variables: the unit directions of each, and the names under which they are kept.

Forwards a direction is one entry of a variable, backwards one number of the outputs; each costs about a solve a step.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.solvers.status import Status, caused

Array = jax.Array
Arrays = dict[str, Array]
BACK = 2.0
"""What a backward pass costs, in forward ones."""
UNSOLVED = caused(
    Status.NOT_FINITE,
    "values are right, and a derivative of an output is not finite: the output has none there, or its solve did not "
    "reach the tolerance (loosen that, or compute in double precision)",
)
"""The status of such a variant."""


def derivative_name(output: str, variable: str) -> str:
    """Under which the derivative of an output in a variable is kept, among the outputs."""
    return f"d({output})/d({variable})"


def forwards(inputs: Mapping[str, Any], outputs: Mapping[str, Any]) -> bool:
    """Whether the Jacobian of arrays or shapes of one variant is found forwards."""
    return _size(inputs) <= BACK * _size(outputs)


def flagged(
    outputs: Mapping[str, np.ndarray], told: dict[str, np.ndarray], names: Sequence[str]
) -> dict[str, np.ndarray]:
    """What is told of variants, with a status for those that converged and have a derivative that is not finite."""
    own = [each for name, each in outputs.items() if any(name.endswith(f")/d({variable})") for variable in names)]
    if not own:
        return told
    finite = np.all([np.isfinite(each).reshape(len(each), -1).all(1) for each in own], axis=0)
    return {**told, "status": np.where((told["status"] == 0) & ~finite, UNSOLVED, told["status"])}


def floating(outputs: Mapping[str, Any]) -> dict[str, Any]:
    """The outputs that have derivatives."""
    return {name: each for name, each in outputs.items() if jnp.issubdtype(each.dtype, jnp.floating)}


def units(arrays: Mapping[str, Any], lead: int = 0) -> Arrays:
    """Unit directions (P, ...) in the numbers of `arrays`, whose first `lead` axes are lanes: one direction for all."""
    shapes = {name: each.shape[lead:] for name, each in arrays.items()}
    sizes = [int(np.prod(shape)) for shape in shapes.values()]
    made, start = {}, 0
    for (name, each), size in zip(arrays.items(), sizes, strict=True):
        rows = np.eye(sum(sizes))[:, start : start + size].reshape(-1, *(1,) * lead, *shapes[name])
        made[name] = jnp.broadcast_to(jnp.asarray(rows, each.dtype), (sum(sizes), *each.shape))
        start += size
    return made


def jacobians(found: Mapping[str, Array], units_of: Mapping[str, Any], lead: int, back: bool) -> Arrays:
    """Derivatives by name, (lanes, *output, *variable), of what the unit directions in `units_of` (P, ...) gave.

    Forwards `found` are changes of outputs (P, lanes, *output), backwards of variables (P, lanes, *variable).
    """
    made, start = {}, 0
    for unit, each in units_of.items():
        shape = each.shape[lead:]
        size = int(np.prod(shape))
        for name, values in found.items():
            part = values[start : start + size]
            own = values.shape[1 + lead :]
            if back:  # (size, lanes, *variable) -> (lanes, *output, *variable)
                moved = jnp.moveaxis(part, 0, lead)
                made[derivative_name(unit, name)] = moved.reshape(*part.shape[1 : 1 + lead], *shape, *own)
            else:
                moved = jnp.moveaxis(part, 0, -1)
                made[derivative_name(name, unit)] = moved.reshape(*part.shape[1 : 1 + lead], *own, *shape)
        start += size
    return made


def with_derivatives(function: Callable[[Arrays], tuple[Arrays, Any]], values: Arrays, names: tuple[str, ...]) -> Any:
    """(outputs, rest) of `function` of one variant's `values`, with the derivatives of the outputs in `names`."""
    varied = {name: values[name] for name in names}

    def of(varied: Arrays) -> tuple[Arrays, Any]:
        outputs, rest = function({**values, **varied})
        return floating(outputs), (outputs, rest)

    if forwards(varied, jax.eval_shape(of, varied)[0]):
        _, changes, every = jax.lax.map(lambda unit: jax.jvp(of, (varied,), (unit,), has_aux=True), units(varied))
        outputs, rest = jax.tree.map(lambda leaf: leaf[0], every)
        return {**outputs, **jacobians(changes, varied, 0, back=False)}, rest
    small, pull, (outputs, rest) = jax.vjp(of, varied, has_aux=True)
    changes = jax.lax.map(lambda unit: pull(unit)[0], units(small))
    return {**outputs, **jacobians(changes, small, 0, back=True)}, rest


def _size(arrays: Mapping[str, Any]) -> int:
    return sum(int(np.prod(each.shape)) for each in arrays.values())
