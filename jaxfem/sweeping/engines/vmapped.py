"""All variants of a chunk side by side by `vmap`: for accelerators."""

from collections.abc import Callable
from typing import Any, ClassVar

import jax

from jaxfem.sweeping.engines.base import Engine, Kept, Task


class Vmapped(Engine):
    """`vmap` over the chunk."""

    name: ClassVar[str] = "vmap"
    width: ClassVar[int] = 256
    elements: ClassVar[float] = 5e5

    def states_at_once(self, width: int) -> int:
        """All."""
        return width

    def make(self, task: Task) -> Callable[[Any, Any, Any], Kept]:
        """Of the whole chunk."""
        return lambda parts, _, values: jax.vmap(lambda each: task.one(parts, each))(values)
