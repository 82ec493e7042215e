"""Forces that supports take, as a load cell beneath a clamp or behind a driven plate reads them."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.elements.elasticity import viscoelastic_force
from jaxfem.fitting.beside.base import At, Datum, Probe, scene_refused
from jaxfem.fitting.beside.rest import rested
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers
from jaxfem.fitting.objective import interpolated
from jaxfem.methods.base import refused_elasticity
from jaxfem.model import Model, Params, State
from jaxfem.pytrees import Pytree, static
from jaxfem.stepping import StepError
from jaxfem.stepping.frames import watched
from jaxfem.system.memory import soon, step_materials
from jaxfem.system.soft import external_force

Array = jax.Array


class SupportForce(Datum, kind="support_force"):
    """The force `values` (3,) [N] with which the body pulls at its support where it rests, known to `sigma`; or (k, 3)
    at the `times` (k,) [s] since the take's release. NaN for a component that was not measured.

    A support is all held nodes, fixed or driven, or those of the body `body`, or those that lie inside `box`, two
    corners [m], in the undeformed scene. The weight of the held nodes is part of it, what a driven support needs to
    move their own mass is not.
    """

    times: Any = None
    body: str | None = None
    box: Any = None

    unit = "N"
    title = "a support's force"

    def numbers(self) -> np.ndarray:
        """Three numbers a time."""
        array = self.checked("values", self.values)
        count = 1 if self.times is None else len(self._times())
        if array.shape[-1:] != (3,) or array.size != 3 * count:
            wanted = "(3,) in N" if self.times is None else f"({count}, 3) in N, three for each of the times"
            raise FitError(f"values of a support's force have the shape {array.shape}; give {wanted}")
        return array.ravel()

    def labels(self) -> Sequence[str]:
        """Axis, and time."""
        whose = "force on the support" if self.body is None else f"force on the support of {self.body}"
        if self.times is None:
            return [f"{whose}, {axis}" for axis in "xyz"]
        return [f"{whose}, {axis} at {time:g} s" for time in self._times() for axis in "xyz"]

    def probe(self, model: Model, markers: Markers, fitted: Sequence[str], spacing: float, dt: float) -> Probe:
        """Which nodes, and when."""
        if model.coupled:
            raise FitError(
                f"{self.title} beside the markers: it is told of soft bodies alone, without contacts or joints"
            )
        if refused := refused_elasticity(model):
            raise FitError(f"{self.title} beside the markers {refused}")
        nodes = tuple(self._nodes(model).tolist())
        if self.times is None:
            return _AtRest(nodes)
        every = max(1, round(spacing / dt))
        times = jnp.asarray(self._times(), model.rest.dtype)
        frames = max(2, int(np.ceil(float(times.max()) / spacing - 1e-6)))
        return _OverTime(times, jnp.asarray(spacing / every, model.rest.dtype), nodes, frames, every)

    def _times(self) -> np.ndarray:
        times = self.checked("times", self.times)
        if times.ndim != 1 or not (np.diff(times) > 0).all() or times.min() < 0:
            raise FitError(f"times of {self.title} is {self.times!r}; give rising times in s since the release, from 0")
        return times

    def _nodes(self, model: Model) -> np.ndarray:
        held = np.asarray(model.free) == 0
        if self.body is not None:
            if self.body not in model.bodies:
                raise FitError(f'{self.title} names no body "{self.body}"; bodies: {", ".join(model.bodies)}')
            held &= np.asarray(model.node_body) == model.bodies.index(self.body)
        if self.box is not None:
            corners = self.checked("box", self.box)
            if corners.shape != (2, 3):
                raise FitError(f"box of {self.title} is {self.box!r}; give two corners (3,) in m")
            rest = np.asarray(model.rest, np.float64)
            slack = 1e-6 * float(np.ptp(rest, axis=0).max())
            inside = (rest >= corners.min(axis=0) - slack) & (rest <= corners.max(axis=0) + slack)
            held &= inside.all(axis=1)
        if not held.any():
            raise FitError(f"{self.title} beside the markers: no held node is there; see body, box and what is fixed")
        return np.flatnonzero(held)


def held_force(model: Model, params: Params, state: State, nodes: tuple[int, ...]) -> Array:
    """The force (3,) [N] of the body on what holds these nodes: elastic, viscous, loads and weight."""
    materials = step_materials(model, params, state, soon(model.rest.dtype))
    inner = viscoelastic_force(model.domains, state.positions, state.velocities, materials, model.rotation_kind)
    total = inner + external_force(model, params, state.positions)
    found: Array = total[np.array(nodes)].sum(axis=0)
    return found


class _AtRest(Pytree):
    nodes: tuple[int, ...] = static()

    def told(self, at: At) -> Array:
        """The force where the body rests [N]."""
        try:
            state, sound = rested(at)
        except StepError as problem:
            raise scene_refused(SupportForce.title, problem) from problem
        return jnp.where(sound, held_force(at.model, at.params, state, self.nodes), jnp.nan)


class _OverTime(Pytree):
    times: Array
    dt: Array
    nodes: tuple[int, ...] = static()
    frames: int = static()
    every: int = static()

    def told(self, at: At) -> Array:
        """The force at the times [N], between frames by cubics."""

        def keep(reached: State) -> Array:
            return held_force(at.model, at.params, reached, self.nodes)

        count = jnp.int32(self.frames)
        kept, status = watched(at.model, at.params, at.state, self.dt, count, self.every, most=self.frames, keep=keep)
        forces = jnp.concatenate([keep(at.state)[None], kept])
        found = interpolated(forces, self.times / (self.every * self.dt))
        return jnp.where(status == 0, found.ravel(), jnp.nan)
