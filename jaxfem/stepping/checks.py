"""What `step`, `rollout` and their like refuse, and the dtype that their numbers get; on the host."""

from functools import partial
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model, Params, State
from jaxfem.stepping.failure import OnFailure

Array = jax.Array
MOST_HALVINGS = 10  # a thousandth of the step


class StepError(ValueError):
    """A call of `step` or `rollout` that cannot be right; the message says what to change."""


def typed(model: Model, *values: Any) -> Any:
    """Arrays of the model's dtype from whatever numbers a user put there, so that no two calls differ by type alone.

    A list, or a tuple of plain numbers, is one array. What a state's method and materials remember keeps its structure,
    and what is no floating-point number in it, as a flag, a count or a random key, its type.
    """

    if not isinstance(model, Model):
        raise StepError(f"the first argument is a {type(model).__name__}; the order is (model, params, state)")

    def one(leaf: Any) -> bool:
        return isinstance(leaf, list) or (
            isinstance(leaf, tuple) and len(leaf) > 0 and all(isinstance(number, int | float) for number in leaf)
        )

    dtype = model.rest.dtype

    def cast(value: Any) -> Any:
        if isinstance(value, State):  # what is remembered has types of its own: flags, counts, random keys
            memory, internal = jax.tree.map(partial(_remembered, dtype), (value.memory, value.internal))
            return cast_numbers(value.replace(memory=None, internal=None)).replace(memory=memory, internal=internal)
        return cast_numbers(value)

    def cast_numbers(value: Any) -> Any:
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), value, is_leaf=one)

    return tuple(map(cast, values))


def _remembered(dtype: Any, leaf: Any) -> Array:
    """A leaf of what a method or a law remembers: of the `dtype` where it is a floating-point number, else as it is."""
    array = jnp.asarray(leaf)
    return jnp.asarray(array, dtype if jnp.issubdtype(array.dtype, jnp.floating) else array.dtype)


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
    if set(params.constants) != set(model.constants):
        held, wanted = sorted(params.constants), sorted(model.constants)
        raise StepError(f"params hold the constants {held}; the scene's materials have {wanted}")
    for name, value in params.constants.items():
        found = jnp.shape(value)
        if found not in ((), (1,), (bodies,), (elements,)):
            raise StepError(
                f"{name} has shape {found}; give one number, one for each of the {bodies} bodies, or one for each of "
                f"the {elements} elements"
            )
    _check_coupled(model, params)
    if jnp.shape(params.gravity) != (3,):
        raise StepError(f"gravity has shape {jnp.shape(params.gravity)}; give three numbers, like (0, 0, -9.81)")
    for name, values, known in (("loads", params.loads, model.loads), ("motions", params.motions, model.driven)):
        if len(values) != len(known):
            raise StepError(f"params.{name} holds {len(values)} values; the scene declares {len(known)}")


def _check_coupled(model: Model, params: Params) -> None:
    if (model.rigid is None) != (params.rigid is None):
        raise StepError(
            "params.rigid and model.rigid belong together: use the params that build returned, with changes"
        )
    if model.rigid is not None and params.rigid is not None:
        found, count = jnp.shape(params.rigid.mass), model.rigid.count
        if found != (count,):
            raise StepError(f"rigid.mass has shape {found}; give one mass for each of the {count} bodies")
    for kind in ("joints", "contacts"):
        given, known = set(getattr(params, kind)), set(getattr(model, kind))
        if given != known:
            raise StepError(f"params.{kind} holds {sorted(given)}; the scene's groups are {sorted(known)}")


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
