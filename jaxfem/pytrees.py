"""Frozen dataclasses that JAX sees as pytrees: the only kind of object that enters a compiled function."""

import dataclasses
import math
import operator
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Self, dataclass_transform

import jax
import jax.numpy as jnp
import numpy as np


def static(**kwargs: Any) -> Any:
    """A field that is part of the program's structure (a flag, a name): changing it compiles anew."""
    return dataclasses.field(metadata={"static": True}, **kwargs)


@dataclass_transform(frozen_default=True, field_specifiers=(static, dataclasses.field))
class Pytree:
    """Base class: each subclass is a frozen dataclass registered with JAX, whose fields are leaves unless `static`."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]  # each subclass has its own

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        again = "__post_init__" if hasattr(cls, "__post_init__") else "__init__"
        if hasattr(cls, "__post_init__") or "__init__" in vars(cls):
            raise TypeError(
                f"{cls.__name__} has {again} of its own: programs make it again from its fields alone. Let fields be "
                "what is given, make what follows from them a property, and refuse values where kinds are checked"
            )
        made: Any = dataclasses.dataclass(frozen=True, eq=False)(cls)
        fields = dataclasses.fields(made)
        if left := [f.name for f in fields if not f.init]:
            raise TypeError(f"{cls.__name__}.{left[0]} is left out of its constructor (init=False): make it a property")
        _register(
            made,
            parts=tuple(f.name for f in fields if not f.metadata.get("static")),
            fixed=tuple(f.name for f in fields if f.metadata.get("static")),
        )

    def replace(self, **changes: Any) -> Self:
        """The same with some fields changed."""
        return dataclasses.replace(self, **changes)


def _register(made: type, parts: tuple[str, ...], fixed: tuple[str, ...]) -> None:
    """Tell JAX of a class: the fields `parts` are its children, and those `fixed` belong to its structure.

    Not by `jax.tree_util.register_dataclass`: structures of two such classes with fields of the same numbers are equal
    (JAX 0.10), and where their hashes happen to share seven bits the one runs the program compiled for the other.
    """
    own, given = _reader(parts), _reader(fixed)
    keys, names = [jax.tree_util.GetAttrKey(name) for name in parts], (*parts, *fixed)

    def told(whole: Any) -> tuple[Any, Any]:
        """The fixed values and what tells equal ones apart; found once, as nothing of it changes."""
        held: tuple[Any, Any] | None = whole.__dict__.get(TOLD)
        if held is None:
            values = given(whole)
            held = whole.__dict__[TOLD] = values, exactly(values)
        return held

    def flat(whole: Any) -> tuple[tuple[Any, ...], tuple[Any, Any]]:
        return own(whole), told(whole)

    def named(whole: Any) -> tuple[list[tuple[Any, Any]], tuple[Any, Any]]:
        return list(zip(keys, own(whole), strict=True)), told(whole)

    def whole(held: tuple[Any, Any], children: Iterable[Any]) -> Any:
        # The constructor of a frozen class takes as long as all else here, and each call of a step comes through here.
        again: Any = object.__new__(made)
        again.__dict__.update(zip(names, (*children, *held[0]), strict=True))
        again.__dict__[TOLD] = held
        return again

    jax.tree_util.register_pytree_with_keys(made, named, whole, flat)


TOLD = "_told"


def exactly(value: Any) -> Any:
    """What tells values apart that Python takes for equal: True, 1 and 1.0, 0.0 and -0.0, words of two kinds."""
    if isinstance(value, tuple):
        parts = tuple(map(exactly, value))
        return type(value), parts[:1] if all(each == parts[0] for each in parts) else parts
    if isinstance(value, float):
        return type(value), math.copysign(1.0, value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return type(value), *(exactly(getattr(value, each.name)) for each in dataclasses.fields(value))
    return type(value)


def _reader(names: tuple[str, ...]) -> Callable[[Any], tuple[Any, ...]]:
    """What gives the values of these fields."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    return lambda whole: tuple([getattr(whole, name) for name in names])


def outline(tree: Any) -> tuple[Any, tuple[tuple[int, ...], ...]]:
    """A tree's structure and the shapes of its leaves: hashable, without arrays."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, tuple(map(jnp.shape, leaves))


def is_key(leaf: Any) -> bool:
    """Whether an array, or the shape of one, holds JAX's random keys, which NumPy does not know."""
    return hasattr(leaf, "dtype") and bool(jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key))


def on_host(tree: Any) -> Any:
    """A tree's arrays as NumPy's; random keys stay what they are."""
    return jax.tree.map(lambda leaf: leaf if is_key(leaf) else np.asarray(leaf), tree)


def without_keys(tree: Any) -> Any:
    """A tree with random keys as the whole numbers that they are made of."""
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if is_key(leaf) else leaf, tree)


def with_keys(leaf: Any, like: Any) -> Any:
    """The key that a leaf of `without_keys` stands for, where that of which it came, `like` this one, is a key."""
    if not is_key(like):
        return leaf
    return jax.random.wrap_key_data(leaf, impl=jax.random.key_impl(jnp.zeros((), like.dtype)))


def on_device(values: Any, dtype: Any) -> jax.Array:
    """Host numbers as a device array. Cast by NumPy first: JAX would compile a program for each shape that it casts."""
    return jnp.asarray(np.asarray(values, dtype), dtype)
