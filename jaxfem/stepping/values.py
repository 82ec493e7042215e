"""What a step is given and gives back, number by number: a status that names the one that cannot be.

Looked at where the numbers are, inside compiled functions: once for all the steps of a rollout, but for the state that
each step ends with.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model, Params, State, StepInfo, element_constants
from jaxfem.ranges import FINITE, Range, ranges_of
from jaxfem.solvers.status import Status, caused

Array = jax.Array

STEP = Range(low=0, open_low=True, advice="must be a positive time step in seconds")
"""Of `dt`."""
UNDEFORMED = Range(
    low=0,
    open_low=True,
    advice="must be positive: the rest positions given to rebuild turn an element inside out, or flat",
)
"""Of the volumes of elements at rest, where `rebuild` made them."""
SMOOTH = Range(
    low=0,
    high=0,
    advice="must be 0: these contacts were declared with friction = 0, which makes no rows for it. Declare a friction "
    "above 0 and build again; params may then set it to any value, 0 too",
)
"""Of the friction of contacts without friction rows."""


def numbers_of(model: Model, params: Params) -> Iterator[tuple[str, Any, Range]]:
    """(name, value, range) of all that `params` hold."""
    for name, constant in model.constants.items():
        yield name, params.constants[name], constant.range
    for law in dict.fromkeys(model.laws):
        for name, (value, allowed) in law.combined(element_constants(model, params)).items():
            yield name, value, allowed
    yield from ranges_of(params.replace(constants={}))
    for label, joints in model.joints.items():
        for what, (value, each) in joints.combined(params.joints[label]).items():
            yield f'joints["{label}"].{what}', value, each
    for label, group in model.contacts.items():
        if not group.rough:
            yield f'contacts["{label}"].friction', params.contacts[label].friction, SMOOTH


def wrong_numbers(model: Model, params: Params) -> list[tuple[str, float, str]]:
    """(name, value, sentence) of each entry of `params` that holds numbers that cannot be; host side."""
    found = []
    for name, value, each in numbers_of(model, params):
        array = np.atleast_1d(np.asarray(value))
        wrong = np.broadcast_to(np.asarray(each.wrong(array)), array.shape)
        if wrong.any():
            place = tuple(int(at) for at in np.argwhere(wrong)[0])
            what = f"{name}{_owner(model, name, array, place[0])} is {array[place]:g}"
            found.append((name, float(array[place]), f"{what}: it {each.text}"))
    return found


def _owner(model: Model, name: str, array: np.ndarray, place: int) -> str:
    """Whose number it is, in words, where each body, element, joint or contact has its own."""
    kind, _, label = name.partition('["')
    label = label.partition('"]')[0]
    if name in model.constants and len(array) == len(model.bodies):
        return f' of body "{model.bodies[place]}"'
    if name in model.constants and len(array) > 1:
        return f" of element {place}"
    if kind in ("joints", "contacts"):
        names: Sequence[str] = getattr(model, kind)[label].names
        return f' of {kind[:-1]} "{names[place]}"' if place < len(names) else ""
    if model.rigid is not None and len(array) == model.rigid.count and name.startswith("rigid."):
        return f' of body "{model.rigid.names[place]}"'
    return ""


def value_status(
    model: Model, params: Params, state: State | None, dt: Array | None = None, forces: Array | None = None
) -> Array:
    """0, or the status that names the first number that cannot be: the time step, the state's, then params and forces.

    Not differentiated.
    """
    shape = [("volumes of elements at rest", model.elements.volumes, UNDEFORMED)] if model.reshaped else []
    looked_at = [
        *shape,
        ("dt", dt, STEP),
        *ranges_of(state, "state"),
        *numbers_of(model, params),
        ("forces", forces, FINITE),
    ]
    return _status([each for each in looked_at if each[1] is not None])


def force_status(forces: Array) -> Array:
    """The same of the forces of one step."""
    return _status([("forces", forces, FINITE)])


def judged(info: StepInfo, state: State, given: Array) -> StepInfo:
    """The info of a step that ended at `state`; `given`: the status of what it was given, which goes first.

    A state that is not finite has a status that says so, whatever the method found.
    """
    lost = (info.status == int(Status.CONVERGED)) & ~_finite(state)
    status = jnp.where(lost, int(Status.NOT_FINITE), info.status)
    judged: StepInfo = info.replace(status=jnp.where(given != 0, given, status).astype(jnp.int32))
    return judged


def _status(looked_at: list[tuple[str, Any, Range]]) -> Array:
    codes = [caused(Status.INVALID_VALUE, f"{name} {each.text}") for name, _, each in looked_at]
    wrong = [each.wrong(jax.lax.stop_gradient(value)).any() for _, value, each in looked_at]
    # The first of several: a select for each, from the last to the first, all in one kernel.
    found: Array = jnp.asarray(int(Status.CONVERGED), jnp.int32)
    for code, bad in zip(reversed(codes), reversed(wrong), strict=True):
        found = jnp.where(bad, jnp.int32(code), found)
    return found


def _finite(state: State) -> Array:
    """Whether a state is: of soft bodies by their nodes, which lead what they remember."""
    places, speeds = jax.lax.stop_gradient((state.positions, state.velocities))
    good = [(jnp.isfinite(places) & jnp.isfinite(speeds)).all() & jnp.isfinite(state.time)]
    if state.accelerations is not None:
        good.append(jnp.isfinite(jax.lax.stop_gradient(state.accelerations)).all())
    if state.rigid is not None:
        good.append(jnp.isfinite(jnp.concatenate(jax.tree.leaves(jax.lax.stop_gradient(state.rigid)), axis=1)).all())
    remembered = jax.tree.leaves(jax.lax.stop_gradient(state.internal))
    good += [jnp.isfinite(leaf).all() for leaf in remembered if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    return jnp.stack(good).all()
