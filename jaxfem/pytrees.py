"""Frozen dataclasses that JAX sees as pytrees: the only kind of object that enters a compiled function."""

import dataclasses
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
    prepares = hasattr(made, "__post_init__")
    keys, names = [jax.tree_util.GetAttrKey(name) for name in parts], (*parts, *fixed)

    def flat(whole: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        return own(whole), given(whole)

    def named(whole: Any) -> tuple[list[tuple[Any, Any]], tuple[Any, ...]]:
        return list(zip(keys, own(whole), strict=True)), given(whole)

    def whole(given: tuple[Any, ...], children: Iterable[Any]) -> Any:
        # The constructor of a frozen class takes as long as all else here, and each call of a step comes through here.
        if prepares:
            return made(**dict(zip(names, (*children, *given), strict=True)))
        again: Any = object.__new__(made)
        again.__dict__.update(zip(names, (*children, *given), strict=True))
        return again

    jax.tree_util.register_pytree_with_keys(made, named, whole, flat)


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
