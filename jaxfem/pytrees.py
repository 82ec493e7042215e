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


def on_device(values: Any, dtype: Any) -> jax.Array:
    """Host numbers as a device array. Cast by NumPy first: JAX would compile a program for each shape that it casts."""
    return jnp.asarray(np.asarray(values, dtype), dtype)
