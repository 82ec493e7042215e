"""What starts inside each other: a warning from `build` that names both sides and the depth."""

import warnings
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.building.enclosed import enclosed_depth
from jaxfem.building.soft import AccuracyWarning
from jaxfem.declared import Contact
from jaxfem.model import Model, State
from jaxfem.rigid.shapes import Shape
from jaxfem.rows.candidates import pairs_of
from jaxfem.system.coupled import configuration

NOTICED = 0.02
"""Of a contact's margin: what is less deep is rounding, or laid by hand."""


class OverlapWarning(AccuracyWarning):
    """Bodies that start inside each other, or in the ground."""


def warn_of_overlaps(contacts: Sequence[Contact], index: BodyIndex, model: Model, values: Any, state: State) -> None:
    """Warn of each contact whose partners are inside each other at the start; host side."""
    gaps = jax.jit(_gaps)(model.contacts, state.replace(memory=None))
    deepest: dict[str, tuple[float, float]] = {}
    known: dict[str, tuple[float, float]] = {}
    for label, group in model.contacts.items():
        gap, speeds = np.asarray(gaps[label]), np.asarray(values[label].separation)
        known |= zip(group.names, zip(np.asarray(group.margin).tolist(), speeds.tolist(), strict=True), strict=True)
        for place in np.flatnonzero(gap < -NOTICED * np.asarray(group.margin)):
            name = group.names[place]
            deepest[name] = min(deepest.get(name, (0.0, 0.0)), (float(gap[place]), float(speeds[place])))
    for number, contact in enumerate(contacts):
        name = contact.name or str(number)
        margin, speed = known[name]
        if name not in deepest and (depth := enclosed_depth(contact, index)) > NOTICED * margin:
            deepest[name] = -depth, speed
        if name in deepest:
            depth, most = deepest[name]
            what = f'contact "{name}"' if contact.name else f"contact {name}"
            warnings.warn(
                f"{what}: {_called(contact.a, index)} and {_called(contact.b, index)} start inside each other, "
                f"{-depth:.3g} m deep. They are moved apart, if that can be, at {most:.3g} m/s at most "
                "(Contact(separation=...)): put them side by side",
                OverlapWarning,
                stacklevel=5,
            )


def _gaps(contacts: Any, state: State) -> dict[str, jax.Array]:
    at = configuration(state)
    return {label: pairs_of(group, at).gap for label, group in contacts.items()}


def _called(partner: Any, index: BodyIndex) -> str:
    if isinstance(partner, Shape):
        return f"the {type(partner).__name__}"
    kind, number = index.find(partner, "a contact")
    return f'"{index.name(kind, number)}"'
