"""What the frames of soft bodies hold, one entry a field; a new one registers itself with `@frame_field(...)`."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described
from jaxfem.declared.errors import SceneError
from jaxfem.model import Model, Params, State
from jaxfem.system.inside import in_world, tensors, von_mises

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

    for what, given in (("name", name), ("unit", unit)):
        if not isinstance(given, str):
            raise ValueError(f"the {what} of a field of the frames is {given!r}: give a text")

    def entered(compute: Compute) -> Compute:
        known = FIELDS.get(name)
        if known is not None and _place(known.compute) != _place(compute):
            raise ValueError(f'two fields of the frames are called "{name}": {_place(known.compute)} and this one')
        if on not in ("node", "element"):
            raise ValueError(f'the field "{name}" is given on {on!r}; give "node" or "element"')
        FIELDS[name] = FrameField(name, unit, on, compute)
        return compute

    return entered


def _place(compute: Compute) -> tuple[str, str, object]:
    """Where a function is defined; the same one defined again, as in a notebook, is the same place."""
    name = compute.__qualname__
    return compute.__module__, name, compute if "<lambda>" in name else None


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
    """Of the stress that the domains take, as a mean over those that an element is part of."""
    return von_mises(tensors(model, params, state)["stress"])


def inside(model: Model, params: Params, state: State, whole: bool) -> dict[str, Array]:
    """What else frames hold of the elements: von Mises values of the strains that laws remember.

    With `whole` also that of the strain, and all of them and the stress as tensors (E, 6): xx, yy, zz, xy, yz, xz.
    """
    if not model.bodies or not (whole or model.has_memory):
        return {}
    found = tensors(model, params, state)
    values = {
        f"von_mises_{name}": von_mises(each, strain=True)
        for name, each in found.items()
        if name != "stress" and (whole or name != "strain")
    }
    turned = in_world(model, state)
    return values | ({name: turned(each) for name, each in found.items()} if whole else {})


def computed(
    model: Model, params: Params, state: State, whole: bool = False, asked: Sequence[str] | None = None
) -> dict[str, Any]:
    """Fields of a frame by name, those `asked` for or all; `whole`: with tensors, which may be asked for too.

    ValueError where one has no entry a node or element, SceneError for a name that is none.
    """
    counts, found = {"node": model.nodes, "element": model.elements.cells.shape[0]}, {}
    for name in FIELDS if asked is None else [name for name in FIELDS if name in asked]:
        field = FIELDS[name]
        given: Any = field.compute(model, params, state)
        if not isinstance(given, jax.Array | np.ndarray):
            raise ValueError(f'the field "{name}" gives {described(given)}; it must give an array')
        if not jnp.issubdtype(given.dtype, jnp.number) and given.dtype != np.bool_:
            raise ValueError(f'the field "{name}" gives {described(given)}; it must give an array of numbers')
        found[name] = jnp.asarray(given)
        if found[name].shape[:1] != (counts[field.on],):
            raise ValueError(
                f'the field "{name}" has shape {found[name].shape}; it needs an entry for each of the '
                f"{counts[field.on]} {field.on}s"
            )
    if asked is None:
        within = inside(model, params, state, whole)
        if twice := sorted(found.keys() & within.keys()):
            raise ValueError(f'the field "{twice[0]}" is there already: give yours another name')
        return found | within
    others = [name for name in asked if name not in FIELDS]
    within = inside(model, params, state, True) if others else {}
    for name in others:
        if name not in within:
            raise SceneError(f'frames have no field "{name}"; known: {", ".join((*FIELDS, *within))}')
    return found | {name: within[name] for name in others}
