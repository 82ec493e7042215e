"""A number of the scene that a gauge of its own told: a pressure, a hanging weight, a speed."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxfem.fitting.beside.base import At, Datum, Probe
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers
from jaxfem.model import Model
from jaxfem.pytrees import Pytree, static


class Gauge(Datum, kind="gauge"):
    """A reading `values` of what stands at `path` in the scene, "load.0" for its first pressure say, known to `sigma`,
    in the path's own unit. It is among the fit's parameters; in several takes each has its own where `own` says so."""

    path: str = ""

    title = "a gauge"

    def labels(self) -> Sequence[str]:
        """The path."""
        return [self.path] * len(self.numbers())

    def probe(self, model: Model, markers: Markers, fitted: Sequence[str], spacing: float, dt: float) -> Probe:
        """Which number."""
        if self.path not in fitted:
            raise FitError(
                f'a gauge reads "{self.path}", which is not fitted: put it among the parameters; '
                f"fitted: {', '.join(fitted)}"
            )
        return _Reading(self.path, len(self.numbers()))


class _Reading(Pytree):
    path: str = static()
    count: int = static()

    def told(self, at: At) -> jax.Array:
        """The trial value."""
        return jnp.broadcast_to(at.values[self.path], (self.count,))
