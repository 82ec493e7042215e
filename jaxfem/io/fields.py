"""What the frames of soft bodies hold, one entry a field; a new one registers itself with `@frame_field(...)`."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import jax

from jaxfem.elements.stress import von_mises_stress
from jaxfem.model import Model, Params, State, element_stiffness

Array = jax.Array
Compute = Callable[[Model, Params, State], Array]


@dataclasses.dataclass(frozen=True)
class FrameField:
    """A field of the frames: its `name` in files, its `unit`, whether it is given on each "node" (n, ...) or
    "element" (E, ...), and how it is computed, in JAX."""

    name: str
    unit: str
    on: Literal["node", "element"]
    compute: Compute


FIELDS: dict[str, FrameField] = {}
"""All fields by name, in the order in which frames hold them."""


def frame_field(name: str, unit: str, on: Literal["node", "element"]) -> Callable[[Compute], Compute]:
    """Enter a function (model, params, state) -> array among the fields that every frame holds."""

    def entered(compute: Compute) -> Compute:
        known = FIELDS.get(name)
        if known is not None and known.compute.__qualname__ != compute.__qualname__:
            raise ValueError(f'two fields of the frames are called "{name}"')
        FIELDS[name] = FrameField(name, unit, on, compute)
        return compute

    return entered


@frame_field("displacement", "m", "node")
def _displacement(model: Model, params: Params, state: State) -> Array:
    return state.positions - model.rest


@frame_field("velocity", "m/s", "node")
def _velocity(model: Model, params: Params, state: State) -> Array:
    return state.velocities


@frame_field("body", "", "element")
def _body(model: Model, params: Params, state: State) -> Array:
    return model.elements.body


@frame_field("von_mises", "Pa", "element")
def _von_mises(model: Model, params: Params, state: State) -> Array:
    _, deviatoric = element_stiffness(model, params)
    stress: Array = von_mises_stress(model.elements, state.positions, deviatoric, model.rotation)
    return stress


def computed(model: Model, params: Params, state: State) -> dict[str, Any]:
    """All fields of a frame by name."""
    return {name: field.compute(model, params, state) for name, field in FIELDS.items()}
