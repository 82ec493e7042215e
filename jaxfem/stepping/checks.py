"""What `step`, `rollout` and their like refuse; on the host."""

from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described
from jaxfem.model import Model, Params, State
from jaxfem.stepping.errors import StepError as StepError
from jaxfem.stepping.failure import OnFailure
from jaxfem.stepping.outlines import check_outline

Array = jax.Array
MOST_HALVINGS = 10  # a thousandth of the step


def check_call(model: Model, params: Params, state: State, dt: Any, forces: Any = None) -> None:
    """Refuse a time step or shapes that cannot be right; values inside jit: see `values.py`."""
    if not isinstance(model, Model) or not isinstance(params, Params) or not isinstance(state, State):
        given = ", ".join(type(v).__name__ for v in (model, params, state))
        raise StepError(f"got ({given}); the order is (model, params, state), as build returns them")
    if not isinstance(dt, jax.core.Tracer) and not (jnp.ndim(dt) == 0 and 0 < float(dt) < float("inf")):
        raise StepError(f"dt is {dt}; give a positive time step in seconds, like 1e-2")
    shape = model.rest.shape
    for name, value in (("positions", state.positions), ("velocities", state.velocities), ("forces", forces)):
        if value is not None and jnp.shape(value) != shape:
            raise StepError(f"{name} has shape {jnp.shape(value)}; the model's {shape[0]} nodes need {shape}")
    if (state.internal is None) == model.has_memory:
        raise StepError("state.internal belongs to materials with a memory: use the state that build returned")
    _check_params(model, params)


def _check_params(model: Model, params: Params) -> None:
    elements, bodies = model.elements.count, len(model.bodies)
    if not isinstance(params.constants, dict) or set(params.constants) != set(model.constants):
        held = sorted(params.constants) if isinstance(params.constants, dict) else described(params.constants)
        raise StepError(f"params hold the constants {held}; the scene's materials have {sorted(model.constants)}")
    for name, value in params.constants.items():
        found = getattr(value, "shape", None)
        if found not in ((), (1,), (bodies,), (elements,)):
            given = f"is {described(value)}" if found is None else f"has shape {found}"
            raise StepError(
                f"{name} {given}; give one number, one for each of the {bodies} bodies, or one for each of the "
                f"{elements} elements"
            )
    check_outline(model, params)


def check_rollout(steps: int, every: int, checkpoint: int | None) -> None:
    """Refuse numbers of steps that saved frames or checkpoints do not divide."""
    for name, value in (("steps", steps), ("every", every)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise StepError(f"{name} is {value!r}; give a whole number")
    if steps < 1 or every < 1 or steps % every:
        raise StepError(f"steps = {steps} must be a positive multiple of every = {every}")
    if checkpoint is not None and (checkpoint < 1 or checkpoint % every or steps % checkpoint):
        raise StepError(f"checkpoint = {checkpoint} must be a multiple of every = {every} and divide steps = {steps}")


def check_failure(on_failure: str, halvings: int) -> None:
    """Refuse an unknown word for what follows a failed step, or a number of halvings that cannot be."""
    if on_failure not in (known := get_args(OnFailure)):
        raise StepError(f"on_failure is {on_failure!r}; give one of {', '.join(map(repr, known))}")
    if isinstance(halvings, bool) or not isinstance(halvings, int) or not 1 <= halvings <= MOST_HALVINGS:
        raise StepError(f"halvings is {halvings!r}; give a whole number from 1 to {MOST_HALVINGS}")


def checked_frequencies(given: Any) -> Any:
    """Frequencies [rad/s] as they were given, traced ones unseen; StepError for values that are none."""
    if isinstance(given, jax.core.Tracer):
        return given
    try:
        known = np.asarray(given, float)
    except (TypeError, ValueError):
        raise StepError(f"frequencies are {given!r}; give numbers in rad/s, as modes does") from None
    if not (known >= 0).all():
        raise StepError(f"frequencies are {given}; each must be 0 or more, in rad/s (NaN: a mode that was not found)")
    return given
