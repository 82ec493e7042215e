"""What is taken of an output that has a value at each saved frame."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp

from jaxfem.model import Model
from jaxfem.sweeping.outputs import Observed, Output

TAKEN: dict[str, Callable[[Any], Any]] = {
    "last": lambda value: value[-1],
    "max": lambda value: jnp.max(value, 0),
    "min": lambda value: jnp.min(value, 0),
    "mean": lambda value: jnp.mean(value, 0),
    "all": lambda value: value,
}
"""By word, of values (k, ...)."""


@dataclasses.dataclass(frozen=True)
class Taken:
    """An output of which `how` says what is kept."""

    output: Output
    how: str = "last"

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """The function of a run."""
        whole, take = self.output.measured(model), TAKEN[self.how if self.output.frames else "all"]

        def kept(run: Observed) -> Any:
            value = whole(run)
            return {name: take(each) for name, each in value.items()} if isinstance(value, Mapping) else take(value)

        return kept
