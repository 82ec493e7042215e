"""What functions of a user's own kinds answer, looked at once on the host, before anything is compiled.

A wrong answer would otherwise come to light in the middle of a trace, in words of JAX, or be spread over what it does
not fit. Only shapes and types are looked at: nothing is computed. What such a function raises is its own, and left.
What a class says of itself, flags and words, is looked at by what is `Wanted` where it is defined.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import Pytree

Shape = tuple[int, ...]


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


def without_hash(tree: Any) -> str:
    """The first static field in a tree by whose value compiled programs cannot be told apart; empty where none is."""
    for whole in jax.tree.leaves(tree, is_leaf=lambda each: isinstance(each, Pytree)):
        for field in dataclasses.fields(whole) if isinstance(whole, Pytree) else ():
            value = getattr(whole, field.name)
            if not field.metadata.get("static"):
                if found := without_hash(value):
                    return found
            elif not hashable(value):
                return field.name
    return ""


def static_flaw(tree: Any) -> str:
    """What is wrong with the first static field in a tree whose value has no hash; empty where none is."""
    name = without_hash(tree)
    return name and f"its static field {name} cannot tell compiled programs apart (a list, an array): give a tuple"


def still_says(cls: type, flag: str, *hooks: str) -> bool:
    """Whether the class in line that says `flag` has the same `hooks`, from the same classes, as this one has."""

    def definers(of: type) -> list[list[type]]:
        return [[each for each in of.__mro__ if hook in vars(each)] for hook in hooks]

    return definers(cls) == definers(cls.__mro__[defined_at(cls, flag)])


def defined_at(cls: type, name: str) -> int:
    """Which class in the line of a class's bases has an attribute; as many as there are where none does."""
    line = cls.__mro__
    return next((number for number, each in enumerate(line) if name in vars(each)), len(line))


def described(value: Any) -> str:
    """A value in words: its shape and type where it is an array."""
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    if isinstance(value, jax.Array | np.ndarray | np.generic | jax.ShapeDtypeStruct):
        return f"an array of shape {jnp.shape(value)} and type {value.dtype}"
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        return f"({', '.join(described(each) for each in value)}{',' * (isinstance(value, tuple) and len(value) == 1)})"
    return f"a {type(value).__name__}"


def is_array(value: Any, shapes: Sequence[Shape], dtype: Any) -> bool:
    """Whether a value is made of real numbers, of one of `shapes`, and makes no other type of those of `dtype`."""
    if isinstance(value, bool) or not isinstance(value, int | float | jax.Array | np.ndarray | np.generic):
        return False
    kind = jax.dtypes.canonicalize_dtype(jnp.result_type(value))
    real = jnp.issubdtype(kind, jnp.integer) or jnp.issubdtype(kind, jnp.floating)
    return bool(real) and jnp.shape(value) in shapes and jnp.result_type(value, jnp.zeros((), dtype)) == dtype


def is_exact(value: Any, shapes: Sequence[Shape], dtype: Any) -> bool:
    """Whether a value is such an array, of the precision of `dtype` itself: what has a derivative, and all digits.

    Numbers of Python, and what is made of them alone, have no precision of their own.
    """
    if not is_array(value, shapes, dtype) or not jnp.issubdtype(jnp.result_type(value), jnp.floating):
        return False
    return type(value) is float or bool(getattr(value, "weak_type", False)) or jnp.result_type(value) == dtype


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
    return odd_word(given, lambda value: is_array(value, shapes, dtype))


def odd_pair(given: Any, second: type) -> tuple[str, Any] | None:
    """The same where each word stands for two values, of which the last is a `second`."""
    return odd_word(given, lambda pair: isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[1], second))


def odd_fields(given: Any, known: Sequence[str]) -> tuple[str, Any] | None:
    """The same where each word stands for a mapping of fields that are `known`."""
    return odd_word(given, lambda fixed: isinstance(fixed, Mapping) and {*fixed} <= {*known})


def odd_word(given: Any, good: Callable[[Any], bool]) -> tuple[str, Any] | None:
    """The same where each word stands for what is `good`."""
    if not isinstance(given, Mapping):
        return "", given
    for word, value in given.items():
        if not isinstance(word, str) or not good(value):
            return f"[{word!r}]", value
    return None


def numbers(given: Any) -> np.ndarray | None:
    """Real numbers as an array of double precision; None for what is none."""
    try:
        array = np.asarray(given)
        return array.astype(float) if array.dtype.kind in "biuf" else None
    except (TypeError, ValueError):  # rows of several lengths
        return None


def texts(given: Any) -> list[str] | None:
    """The texts that it holds or yields; None for what is no list of such."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        return None
    found = list(given)
    return found if all(isinstance(each, str) for each in found) else None


class Wanted(NamedTuple):
    """What a value has to be: in words, and whether one is."""

    words: str
    good: Callable[[Any], bool]


def flaw_of(given: Any, kinds: Mapping[str, Wanted]) -> str:
    """What is wrong with the first attribute of `given` that is not of its kind, in words; empty where all are.

    What a class finds out for each of its objects, by a property, is theirs to say.
    """
    for name, kind in kinds.items():
        value = getattr(given, name)
        if not isinstance(value, property) and not kind.good(value):
            return f"{name} = {described(value)}: give {kind.words}"
    return ""


def is_number(value: Any) -> bool:
    """Whether it is one real number, of Python's, NumPy's or JAX's."""
    return _single(value, jnp.integer, jnp.floating)


def _single(value: Any, *types: Any) -> bool:
    known = isinstance(value, int | float | jax.Array | np.ndarray | np.generic) and jnp.shape(value) == ()
    return known and any(jnp.issubdtype(jnp.result_type(value), each) for each in types)


def _is_interval(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(is_number, value)) and bool(value[0] < value[1])


FLAG = Wanted("True or False", lambda value: isinstance(value, bool | np.bool_))
TEXT = Wanted("a text", lambda value: isinstance(value, str))
NUMBER = Wanted("a number", is_number)
WHOLE = Wanted("an integer", lambda value: isinstance(value, int) and not isinstance(value, bool))
INTERVAL = Wanted("two numbers, the lower one first", _is_interval)
COUNT = Wanted("one integer ()", lambda value: _single(value, jnp.integer))
REAL = Wanted("one real number ()", is_number)
