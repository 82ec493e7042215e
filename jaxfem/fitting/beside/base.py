"""What data beside markers are: numbers that were measured, how well, and what a scene tells of them.

A kind is a subclass of `Datum` in a file of its own; it registers itself under the word that fit files call it.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, Protocol, dataclass_transform

import jax
import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers
from jaxfem.model import Model, Params, State
from jaxfem.registry import Registry

Array = jax.Array


@dataclasses.dataclass(frozen=True)
class At:
    """A scene at trial values: `model`, `params`, `state` at the start, `markers`, the trial `values` by the names that
    they have in this take."""

    model: Model
    params: Params
    state: State
    markers: Markers
    values: dict[str, Array]


class Probe(Protocol):
    """What of a datum enters the compiled program, a Pytree."""

    def told(self, at: At) -> Array:
        """What the scene tells of the data (k,); NaN where it cannot. Traceable, differentiable forwards."""


@dataclass_transform(frozen_default=True)
@dataclasses.dataclass(frozen=True)
class Datum:
    """Base class: a frozen dataclass with fields `values` and `sigma`, numbers in `unit` and their standard
    uncertainties; `title` names it to people."""

    word: ClassVar[str] = ""
    unit: ClassVar[str] = ""
    title: ClassVar[str] = ""
    values: Any
    sigma: Any

    def __init_subclass__(cls, kind: str = "", **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        dataclasses.dataclass(frozen=True)(cls)
        if kind:
            cls.word = kind
            KINDS.add(kind, cls)

    def numbers(self) -> np.ndarray:
        """What was measured, (k,); NaN where nothing was."""
        return self.checked("values", self.values).ravel()

    def labels(self) -> Sequence[str]:
        """What each number is."""
        raise NotImplementedError

    def probe(self, model: Model, markers: Markers, fitted: Sequence[str], spacing: float, dt: float) -> Probe:
        """What enters the compiled program, for a take with samples `spacing` [s] apart and steps of about `dt` [s];
        `fitted`: names of what is fitted. FitError where the scene cannot tell the data."""
        raise NotImplementedError

    def scale(self) -> np.ndarray:
        """Standard uncertainties (k,)."""
        count = len(self.numbers())
        sigma = self.checked("sigma", self.sigma)
        if sigma.size not in (1, count) or not (sigma > 0).all():
            raise FitError(
                f"sigma of {self.title} is {self.sigma!r}; give one positive number in {self.unit or 'its unit'}, or "
                f"one for each of the {count}"
            )
        return np.broadcast_to(sigma.ravel(), (count,))

    def checked(self, name: str, value: Any) -> np.ndarray:
        """Numbers of a field; FitError where there are none."""
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.zeros(0)
        if array.size == 0 or np.isinf(array).any() or np.isnan(array).all():
            raise FitError(f"{name} of {self.title} is {value!r}; give finite numbers in {self.unit or 'its unit'}")
        return array


KINDS: Registry[Datum] = Registry("data beside markers")
"""Every kind by its word in fit files."""


def scene_refused(title: str, problem: Exception) -> FitError:
    """The error for a scene that cannot tell data of that title."""
    return FitError(f"{title} beside the markers: {problem}")
