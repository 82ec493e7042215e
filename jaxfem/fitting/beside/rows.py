"""Rows of data beside markers in a fit: predicted less measured, in standard uncertainties, with their derivatives."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.beside.base import At, Datum, Probe
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers, moved_places
from jaxfem.fitting.objective import shift_array
from jaxfem.fitting.paths import with_all
from jaxfem.fitting.unknowns import DELAY
from jaxfem.materials.constants import Constant
from jaxfem.model import Model, Params, State
from jaxfem.pytrees import Pytree

Array = jax.Array


class Aside(Pytree):
    """Arrays of one datum: the take's scene and markers, its `probe`, what was `measured` (k,), one over `sigma`
    (k,), 0 where nothing was measured."""

    model: Model
    params: Params
    state: State
    markers: Markers
    probe: Any
    measured: Array
    weights: Array


@dataclasses.dataclass(frozen=True)
class Beside:
    """One number beside the markers: `measured`, with standard uncertainty `sigma`, and as the fit `predicted` it."""

    what: str
    measured: float
    predicted: float
    sigma: float
    unit: str

    @property
    def off(self) -> float:
        """Predicted less measured, in standard uncertainties."""
        return (self.predicted - self.measured) / self.sigma

    def line(self) -> str:
        """One line."""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.what}: {self.predicted:.5g}{unit} for {self.measured:.5g} +- {self.sigma:.2g} measured "
            f"({self.off:+.1f} standard uncertainties)"
        )


class DataOf:
    """One datum of a take, `what`, as a fit evaluates it: `columns` (p,) of the unknowns z are its own, as the take's
    `constants`."""

    def __init__(self, what: Datum, aside: Aside, constants: tuple[Constant, ...], columns: np.ndarray):
        self.what, self.aside, self.constants, self.columns = what, aside, constants, columns
        self.last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def on(self, **changes: Any) -> "DataOf":
        """The same on another scene, with other markers."""
        return DataOf(self.what, self.aside.replace(**changes), self.constants, self.columns)

    def rows(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k,) in standard uncertainties, and derivatives (k, P); not finite where the scene cannot tell them."""
        if self.last is None or not np.array_equal(self.last[0], z):
            own = jnp.asarray(z[self.columns], self.aside.model.rest.dtype)
            row, slope = data_rows_linear(own, self.aside, self.constants)
            jacobian = np.zeros((len(row), z.size))
            jacobian[:, self.columns] = np.asarray(slope, np.float64)
            self.last = np.array(z), np.asarray(row, np.float64), jacobian
        return self.last[1], self.last[2]

    def told(self, z: np.ndarray) -> list[Beside]:
        """Measured beside predicted."""
        rows, scale, measured = self.rows(z)[0], self.what.scale(), self.what.numbers()
        return [
            Beside(label, float(value), float(value + row * sigma), float(sigma), self.what.unit)
            for label, value, row, sigma in zip(self.what.labels(), measured, rows, scale, strict=True)
            if np.isfinite(value)
        ]


def data_of(
    data: Sequence[Any],
    scene: tuple[Model, Params, State, Markers],
    names: Sequence[str],
    own: Mapping[str, Constant],
    spacing: float,
    dt: float,
) -> list[DataOf]:
    """What a fit evaluates of a take's `data`; `names` of the fit's unknowns, `own`: which constants these are in the
    take. FitError for what is no datum, or what the scene cannot tell."""
    model, params, state, markers = scene
    columns = [k for k, name in enumerate(names) if name in own]
    constants = tuple(own[names[k]] for k in columns)
    dtype, found = model.rest.dtype, []
    for each in data:
        if not isinstance(each, Datum):
            raise FitError(
                f"data beside the markers hold {each!r}; give Frequencies, Settled, SupportForce or Gauge objects"
            )
        numbers, scale = each.numbers(), each.scale()
        probe: Probe = each.probe(model, markers, [one.name for one in constants], spacing, dt)
        known = np.isfinite(numbers)
        arrays = (np.where(known, numbers, 0.0), np.where(known, 1 / scale, 0.0))
        aside = Aside(model, params, state, markers, probe, *(jnp.asarray(a, dtype) for a in arrays))
        found.append(DataOf(each, aside, constants, np.array(columns, int)))
    return found


def data_rows(z: Array, aside: Aside, constants: tuple[Constant, ...]) -> Array:
    """Predicted less measured (k,), in standard uncertainties, at the take's own z (p,); traceable."""
    values = {each.name: each.transform.value(z[i]) for i, each in enumerate(constants)}
    placed = {name: value for name, value in values.items() if name != DELAY.name}
    params, state = with_all(aside.params, aside.state, placed, constants)
    markers = moved_places(aside.markers, shift_array(values, constants, aside.markers.count, z.dtype))
    told = aside.probe.told(At(aside.model, params, state, markers, values))
    return jnp.where(aside.weights > 0, told - aside.measured, 0.0) * aside.weights


@partial(jax.jit, static_argnames="constants")
def data_rows_linear(z: Array, aside: Aside, constants: tuple[Constant, ...]) -> tuple[Array, Array]:
    """`data_rows` and their derivatives (k, p)."""
    if z.size == 0:
        row = data_rows(z, aside, constants)
        return row, jnp.zeros((row.size, 0), row.dtype)

    def tangent(direction: Array) -> tuple[Array, Array]:
        return jax.jvp(lambda u: data_rows(u, aside, constants), (z,), (direction,))

    row, slopes = jax.vmap(tangent, out_axes=(None, 0))(jnp.eye(z.size, dtype=z.dtype))
    return row, slopes.T
