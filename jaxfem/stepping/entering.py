"""Whatever numbers a user put into params, a state, a time step or forces, as arrays of the model's type; on the host.

What is fine is cast and nothing else. Only where that fails is looked for what it was, to name it.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described
from jaxfem.model import Model, Params, State
from jaxfem.ranges import ranges_of
from jaxfem.stepping.errors import StepError

Array = jax.Array
OTHERS = ("dt", "forces")
REFUSED = (str, bytes, complex)
"""Types that NumPy would make numbers of, or cut down to numbers."""


def typed(model: Model, *values: Any, others: Sequence[str] = OTHERS) -> Any:
    """Arrays of the model's dtype from whatever numbers a user put there, so that no two calls differ by type alone.

    A list, or a tuple of plain numbers, is one array. What a state's method and materials remember keeps its structure,
    and what is no floating-point number in it, as a flag, a count or a random key, its type. StepError names what is no
    real number, and what the dtype cannot hold; `others`: names of the values that are neither params nor state.
    """
    if not isinstance(model, Model):
        raise StepError(f"the first argument is a {type(model).__name__}; the order is (model, params, state)")
    dtype = model.rest.dtype
    try:
        with np.errstate(over="raise"):
            return tuple(_entered(dtype, value) for value in values)
    except (TypeError, ValueError, ArithmeticError):
        for name, leaf in _named(values, others):
            _refuse(dtype, name, leaf)
        raise


def _entered(dtype: Any, value: Any) -> Any:
    cast = partial(_cast, dtype)
    if isinstance(value, Params) and isinstance(value.loads, list):  # one value a load, as in a tuple
        value = value.replace(loads=tuple(value.loads))
    if not isinstance(value, State):
        return jax.tree.map(cast, value, is_leaf=_is_array)
    memory, internal = jax.tree.map(partial(_remembered, dtype), (value.memory, value.internal))
    bare: State = jax.tree.map(cast, value.replace(memory=None, internal=None), is_leaf=_is_array)
    return bare.replace(memory=memory, internal=internal)


def _is_array(value: Any) -> bool:
    """Whether a list or tuple is one array, and no tree of some."""
    return isinstance(value, list) or (
        isinstance(value, tuple) and len(value) > 0 and all(isinstance(number, int | float) for number in value)
    )


def _is_real(dtype: Any) -> bool:
    """Whether it is a type of real numbers, such as NumPy does not know (bfloat16) too."""
    return any(jnp.issubdtype(dtype, each) for each in (jnp.bool_, jnp.integer, jnp.floating))


def _cast(dtype: Any, leaf: Any) -> Array:
    """One array; TypeError, ValueError or ArithmeticError where it cannot be one."""
    held = getattr(leaf, "dtype", None)
    if held == dtype and isinstance(leaf, jax.Array) and not leaf.weak_type:
        return leaf
    if isinstance(leaf, REFUSED) or (held is not None and held != dtype and not _is_real(held)):
        raise TypeError("no real number")
    return jnp.asarray(leaf, dtype)


def _remembered(dtype: Any, leaf: Any) -> Array:
    """A leaf of what a method or a law remembers: of the `dtype` where it is a floating-point number, else as it is."""
    array = jnp.asarray(leaf)
    return jnp.asarray(array, dtype if jnp.issubdtype(array.dtype, jnp.floating) else array.dtype)


def _named(values: Sequence[Any], others: Sequence[str]) -> Iterator[tuple[str, Any]]:
    """The leaves of all that is cast, by the names that Python reaches them by."""
    further = iter(others)
    for value in values:
        if isinstance(value, Params) and isinstance(value.constants, dict):
            yield from value.constants.items()
            value = value.replace(constants={})
        if isinstance(value, Params | State):
            where = "state" if isinstance(value, State) else ""
            yield from ((name, leaf) for name, leaf, _ in ranges_of(value, where, is_leaf=_is_array))
        else:
            yield next(further, "a value"), value


def _refuse(dtype: Any, name: str, leaf: Any) -> None:
    """StepError where a leaf cannot be cast."""
    try:
        with np.errstate(over="raise"):
            jax.tree.map(partial(_cast, dtype), leaf, is_leaf=_is_array)
    except ArithmeticError:
        raise StepError(
            f"{name} is {_shown(leaf)}, more than {dtype} holds ({float(jnp.finfo(dtype).max):.2g} at most): give less"
            + (", or build with dtype = float64" if dtype == jnp.float32 else "")
        ) from None
    except (TypeError, ValueError):
        raise StepError(f"{name} is {_shown(leaf)}; give a real number, or an array of such") from None


def _shown(leaf: Any) -> str:
    text = repr(leaf)
    if len(text) <= 60 and "\n" not in text:
        return text
    return described(leaf) if len(described(leaf)) <= 200 else f"a {type(leaf).__name__}"
