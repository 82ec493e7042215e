"""Frozen dataclasses that JAX sees as pytrees: the only kind of object that enters a compiled function."""

import dataclasses
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
        jax.tree_util.register_dataclass(
            made,
            data_fields=[f.name for f in fields if not f.metadata.get("static")],
            meta_fields=[f.name for f in fields if f.metadata.get("static")],
        )

    def replace(self, **changes: Any) -> Self:
        """The same with some fields changed."""
        return dataclasses.replace(self, **changes)


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
