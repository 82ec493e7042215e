"""A settled shape: where markers rest under the loads, from a photograph, a ruler or the end of another recording."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.beside.base import At, Datum, Probe, scene_refused
from jaxfem.fitting.beside.rest import rested
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers, marker_places
from jaxfem.model import Model
from jaxfem.pytrees import Pytree, static
from jaxfem.stepping import StepError


class Settled(Datum, kind="settled"):
    """How far markers lie at rest from where they start: `values`, marker's name -> (3,) [m] along the scene's axes,
    NaN for one that was not measured; known to `sigma` [m]. `places`: values are the places themselves."""

    places: bool = False

    unit = "m"
    title = "a settled shape"

    def numbers(self) -> np.ndarray:
        """Three numbers a marker."""
        if not isinstance(self.values, Mapping) or not self.values:
            raise FitError(
                f"values of a settled shape is {self.values!r}; give markers' names and (3,) in m, "
                "like {'tip': (0, 0, -0.004)}"
            )
        found = [self.checked(f"the place of {name}", value) for name, value in self.values.items()]
        for name, each in zip(self.values, found, strict=True):
            if each.shape != (3,):
                raise FitError(f'values of a settled shape: "{name}" has {each.size} numbers; give three, in m')
        return np.concatenate(found)

    def labels(self) -> Sequence[str]:
        """Marker and axis."""
        return [f"{name} {axis} at rest" for name in self.values for axis in "xyz"]

    def probe(self, model: Model, markers: Markers, fitted: Sequence[str], spacing: float, dt: float) -> Probe:
        """Which markers."""
        self.numbers()
        missing = [name for name in self.values if name not in markers.names]
        if missing:
            raise FitError(f'a settled shape names no marker "{missing[0]}"; markers: {", ".join(markers.names)}')
        return _Rest(tuple(markers.names.index(name) for name in self.values), bool(self.places))


class _Rest(Pytree):
    marks: tuple[int, ...] = static()
    places: bool = static()

    def told(self, at: At) -> jax.Array:
        """Coordinates at rest, less those at the start [m]."""
        try:
            state, sound = rested(at)
        except StepError as problem:
            raise scene_refused(Settled.title, problem) from problem
        found = marker_places(at.markers, state)
        if not self.places:
            found = found - marker_places(at.markers, at.state)
        return jnp.where(sound, found[np.array(self.marks)].ravel(), jnp.nan)
