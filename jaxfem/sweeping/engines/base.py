"""What an engine is: a way to compute all variants of a chunk, chosen with `sweep(engine=...)`."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import numpy as np

from jaxfem.answers import described
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.registry import Registry
from jaxfem.stepping import rollout
from jaxfem.sweeping.derivatives import with_derivatives
from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.outputs import Observed
from jaxfem.sweeping.places import Place, placed

Array = jax.Array
Kept = tuple[dict[str, Array], dict[str, Array]]
"""Outputs, and of each variant `status`, `iterations` (a step), `residual`, `inverted`."""


FEWEST = 200  # elements that a variant counts as at least, where a chunk's width is chosen


@dataclasses.dataclass(frozen=True)
class Task:
    """What each variant is: the scene, `steps` of `dt`, a saved state `every` so many, variables and outputs.

    `change` (params, state, values) -> (params, state): what a user does with values beyond their `places`, or None.
    `derivatives`: variables in which those of the outputs are kept beside them.
    """

    model: Model
    params: Params
    state: State
    dt: float
    steps: int
    every: int
    places: tuple[Place, ...]
    measure: Callable[[Observed], dict[str, Array]]
    change: Callable[..., tuple[Params, State]] | None = None
    halvings: int = 0
    derivatives: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables that have places."""
        return tuple(place.name for place in self.places)

    def variant(self, parts: tuple[Model, Params, State], values: dict[str, Array]) -> tuple[Params, State, Any]:
        """Params, start and time step of a variant; `parts`: the scene as the compiled function was given it."""
        model, params, state = parts
        params, state, dt = placed(model, params, state, self.dt, list(self.places), values)
        if self.change is not None:
            made = self.change(params, state, values)
            if not (
                isinstance(made, tuple)
                and len(made) == 2
                and isinstance(made[0], Params)
                and isinstance(made[1], State)
            ):
                raise SweepError(f"change gave {described(made)}; give (params, state), as it was given them")
            params, state = made
        return params, state, dt

    def one(self, parts: tuple[Model, Params, State], values: dict[str, Array]) -> Kept:
        """What is kept of one variant: by `rollout`, whatever the scene."""
        if not self.derivatives:
            return self._plain(parts, values)
        made: Kept = with_derivatives(lambda own: self._plain(parts, own), values, self.derivatives)
        return made

    def _plain(self, parts: tuple[Model, Params, State], values: dict[str, Array]) -> Kept:
        model = parts[0]
        params, state, dt = self.variant(parts, values)
        failing: Any = {"on_failure": "halve", "halvings": self.halvings} if self.halvings else {"on_failure": "stop"}
        states, infos = rollout(model, params, state, dt, self.steps, every=self.every, **failing)
        run = Observed(model, params, state, states, infos, jax.numpy.asarray(dt, model.rest.dtype))
        return self.measure(run), told(infos)


def told(infos: StepInfo) -> dict[str, Array]:
    """The first status that is not 0, most iterations and largest residual of a step, most elements inside out."""
    first = jax.numpy.argmax(infos.status != 0)
    return {
        "status": infos.status[first],
        "iterations": infos.iterations.max(),
        "residual": infos.residual.max(),
        "inverted": infos.inverted.max(),
    }


class Engine:
    """A way to compute chunks; where nothing else is asked for `width` variants in each, on accelerators more, until
    they have `elements` together."""

    name: ClassVar[str]
    width: ClassVar[int] = 32
    elements: ClassVar[float] = 0.0

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        ENGINES.add(cls.name, cls)

    def refuses(self, task: Task) -> str | None:
        """Why it cannot serve a task, in words that follow its name, or None."""
        return None

    def slower(self, task: Task) -> str | None:
        """Why another serves a task faster, although this one can, in words that follow its name, or None."""
        return None

    def widest(self, task: Task, platform: str) -> int:
        """Variants a chunk, as far as there are so many."""
        more = 0 if platform == "cpu" else self.elements // max(task.model.elements.count, FEWEST)
        return max(self.width, int(more))

    def states_at_once(self, width: int) -> int:
        """How many variants' saved states are in memory at one time, of a chunk of that width."""
        return 1

    def prepare(self, task: Task) -> Any:
        """What all chunks share, made once on the host."""
        return None

    def costs(self, task: Task, prepared: Any, variants: Mapping[str, np.ndarray]) -> np.ndarray | None:
        """What each variant costs, (V,) up to a factor, where those of a chunk wait for each other; else None."""
        return None

    def make(self, task: Task) -> Callable[[tuple[Model, Params, State], Any, dict[str, Array]], Kept]:
        """The function of the scene, of what was prepared, and of a chunk's values (W, ...), to be compiled."""
        raise NotImplementedError


ENGINES: Registry[Engine] = Registry("engine")
"""All engines by name."""
