"""Natural frequencies, as a tap and a spectrum tell them."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.declared.errors import checked_choice
from jaxfem.fitting.beside.base import At, Datum, Probe, scene_refused
from jaxfem.fitting.beside.rest import rested
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers
from jaxfem.model import Model
from jaxfem.pytrees import Pytree, static
from jaxfem.stepping import StepError
from jaxfem.vibration import modes

ABOUT = ("rest", "start")


class Frequencies(Datum, kind="frequencies"):
    """Natural frequencies `values` (k,) [Hz], known to `sigma`, of the modes numbered `modes` (from 1, the lowest; the
    first k without it), about where the body rests under its loads, or `about` = "start", where the take starts.

    Of small vibrations, damping left out: what is read off a damped ringing is lower by zeta^2 / 2 of itself. The
    lightly damped ones of a soft body's own; supports stand still.
    """

    modes: Any = None
    about: str = "rest"

    unit = "Hz"
    title = "frequencies"

    def labels(self) -> Sequence[str]:
        """The modes' numbers."""
        return [f"frequency {number}" for number in self._numbers()]

    def probe(self, model: Model, markers: Markers, fitted: Sequence[str], spacing: float, dt: float) -> Probe:
        """Which modes, about what."""
        checked_choice("about", self.about, ABOUT, FitError)
        numbers = tuple(self._numbers())
        if max(numbers) > 3 * model.nodes:
            raise FitError(f"frequencies beside the markers: the scene has no mode {max(numbers)}")
        found = _Modes(numbers, self.about == "rest")
        return found

    def _numbers(self) -> list[int]:
        count = len(self.numbers())
        given = list(range(1, count + 1)) if self.modes is None else np.atleast_1d(np.asarray(self.modes)).tolist()
        whole = all(isinstance(each, int) and not isinstance(each, bool) and each >= 1 for each in given)
        if not whole or len(given) != count or len(set(given)) < count:
            raise FitError(f"modes of frequencies is {self.modes!r}; give {count} different whole numbers from 1 up")
        return given


class _Modes(Pytree):
    numbers: tuple[int, ...] = static()
    rest: bool = static()

    def told(self, at: At) -> jax.Array:
        """Frequencies [Hz]."""
        try:
            state, sound = rested(at) if self.rest else (at.state, jnp.ones((), bool))
            found, _ = modes(at.model, at.params, state, count=max(self.numbers))
        except StepError as problem:
            raise scene_refused(Frequencies.title, problem) from problem
        return jnp.where(sound, found[np.array(self.numbers) - 1], jnp.nan) / (2 * jnp.pi)
