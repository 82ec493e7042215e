"""What functions of a user's own kinds answer, looked at once on the host, before anything is compiled.

A wrong answer would otherwise come to light in the middle of a trace, in words of JAX, or be spread over what it does
not fit. Only shapes and types are looked at: nothing is computed. What such a function raises is its own, and left.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Shape = tuple[int, ...]
STATIC = "a static field of it cannot tell compiled programs apart (a list, an array): give a tuple"
"""Of fields that are part of the program and have no hash."""


def asked(look: Callable[[Any], str], function: Callable[..., Any], *given: Any) -> str:
    """What `look` finds wrong with the answer of a function to values of the shapes of `given`; empty: nothing."""
    found: list[str] = []

    def run(*values: Any) -> tuple[()]:
        found.append(look(function(*values)))
        return ()

    jax.eval_shape(run, *given)
    return found[0]


def hashable(value: Any) -> bool:
    """Whether compiled programs can tell it from others by its value."""
    try:
        hash(value)
    except TypeError:
        return False
    return True


def described(value: Any) -> str:
    """A value in words: its shape and type where it is an array."""
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    if isinstance(value, jax.Array | np.ndarray | np.generic | jax.ShapeDtypeStruct):
        return f"an array of shape {jnp.shape(value)} and type {value.dtype}"
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        return f"({', '.join(described(each) for each in value)})"
    return f"a {type(value).__name__}"


def is_array(value: Any, shapes: Sequence[Shape], dtype: Any) -> bool:
    """Whether a value is made of real numbers, of one of `shapes`, and makes no other type of those of `dtype`."""
    if isinstance(value, bool) or not isinstance(value, int | float | jax.Array | np.ndarray | np.generic):
        return False
    kind = jax.dtypes.canonicalize_dtype(jnp.result_type(value))
    real = jnp.issubdtype(kind, jnp.integer) or jnp.issubdtype(kind, jnp.floating)
    return bool(real) and jnp.shape(value) in shapes and jnp.result_type(value, jnp.zeros((), dtype)) == dtype


def structure(tree: Any) -> Any:
    """What a tree is made of, beside its leaves."""
    return jax.tree.structure(tree)


def alike(value: Any, other: Any) -> bool:
    """Whether two trees of arrays have one structure, and their leaves one shape and type."""
    if structure(value) != structure(other):
        return False
    pairs = zip(jax.tree.leaves(value), jax.tree.leaves(other), strict=True)
    return all(jnp.shape(a) == jnp.shape(b) and _type(a) == _type(b) for a, b in pairs)


def _type(value: Any) -> Any:
    return value.dtype if hasattr(value, "dtype") else jnp.result_type(value)


def odd_leaf(tree: Any) -> tuple[str, Any] | None:
    """The place and value of the first leaf that no compiled function can hold, like a text; None without one."""
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        try:
            jax.eval_shape(lambda value: value, leaf)
        except TypeError:
            return jax.tree_util.keystr(path), leaf
    return None


def odd_entry(given: Any, shapes: Sequence[Shape], dtype: Any) -> tuple[str, Any] | None:
    """The first entry of a mapping that is no word for such an array, or what is no mapping; None where all are."""
    if not isinstance(given, Mapping):
        return "", given
    for word, value in given.items():
        if not isinstance(word, str) or not is_array(value, shapes, dtype):
            return f"[{word!r}]", value
    return None
