"""Variants one after another inside one program: for every scene, and the fastest way on CPUs but for lanes."""

from collections.abc import Callable
from typing import Any, ClassVar

import jax

from jaxfem.sweeping.engines.base import Engine, Kept, Task


class InTurn(Engine):
    """`lax.map` over the chunk."""

    name: ClassVar[str] = "loop"

    def make(self, task: Task) -> Callable[[Any, Any, Any], Kept]:
        """Of the whole chunk."""
        return lambda parts, _, values: jax.lax.map(lambda each: task.one(parts, each), values)
