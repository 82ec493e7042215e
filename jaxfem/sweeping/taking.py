"""What is taken of an output that has a value at each saved frame."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described
from jaxfem.model import Model
from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.outputs import Observed, Output

TAKEN: dict[str, Callable[[Any], Any]] = {
    "last": lambda value: value[-1],
    "max": lambda value: jnp.max(value, 0),
    "min": lambda value: jnp.min(value, 0),
    "mean": lambda value: jnp.mean(value, 0),
    "all": lambda value: value,
}
"""By word, of values (k, ...)."""


def _check_frames(output: Output, value: Any) -> None:
    """SweepError for an output that has no entry for each saved frame, though it says so."""
    for each in value.values() if isinstance(value, Mapping) else [value]:
        if not isinstance(each, jax.Array | np.ndarray) or each.ndim < 1:
            raise SweepError(
                f"`measured` of {type(output).__name__} gives a function that gives {described(each)}; it must give an "
                "array with an entry for each saved frame, or say `frames = False`"
            )


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
            if self.output.frames:
                _check_frames(self.output, value)
            return {name: take(each) for name, each in value.items()} if isinstance(value, Mapping) else take(value)

        return kept
