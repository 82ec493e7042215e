"""step and rollout: pure, jitted, differentiable in every float of params and state."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.solvers.differentiation import recomputed
from jaxfem.stepping.begin import begun
from jaxfem.stepping.checks import StepError, check_call, check_failure, check_rollout, checked_frequencies
from jaxfem.stepping.entering import typed
from jaxfem.stepping.failure import OnFailure, forgetting, persistent
from jaxfem.stepping.taken import check_memory, prepared, step_taken
from jaxfem.stepping.values import force_status, judged, value_status

Array = jax.Array


def step(model: Model, params: Params, state: State, dt: Any, *, forces: Any = None) -> tuple[State, StepInfo]:
    """Advance by one time step `dt` [s]: (next state, info).

    `forces` (n, 3) [N]: extra nodal forces, held over the step. Differentiable (jvp, vjp, nested) in params, state, dt
    and forces; vmappable. `info.status` is 0 when the solve converged: see `jaxfem.solvers.describe`. A number that
    cannot be (in `params`, the state, dt or forces) is named by it, and a state that is not finite never has status 0.
    Raises StepError for dt <= 0, wrong shapes, and what is no number or none that the precision holds.
    Source: Benevolensky & Voroshilov 2009.
    """
    params, state, dt_, forces = typed(model, params, state, dt, forces)
    check_call(model, params, state, dt, forces)
    following: tuple[State, StepInfo] = _step(model, params, state, dt_, forces)
    return following


@jax.jit
def _step(model: Model, params: Params, state: State, dt: Array, forces: Array | None) -> tuple[State, StepInfo]:
    given = value_status(model, params, state, dt, forces)
    state = begun(model, params, state, forces)
    following, info = step_taken(model, params, state, dt, forces, cached(model, params, state, dt))
    return following, judged(info, following, given)


def prepare(model: Model, params: Params, state: State, dt: Any, *, frequencies: Any = None) -> Model:
    """The model with the solver's preconditioner built in, for loops of your own over `step` [dt in s].

    Without it each call of `step` builds one (some milliseconds); `rollout` builds one for all its steps. It never
    changes a solution, only how fast it is found: prepare again after changing E, density or dt tenfold.
    `frequencies` [rad/s], such as `jf.modes` finds: the info of each step then holds the damping ratio that the time
    scheme gives to each (`info.scheme_damping`); None keeps those that the model has. StepError for others than numbers
    from 0 up.
    """
    params, state, dt_ = typed(model, params, state, dt)
    check_call(model, params, state, dt)
    if frequencies is not None:
        (known,) = typed(model, checked_frequencies(frequencies), others=("frequencies",))
        model = model.replace(frequencies=known)
    return model.replace(cache=_prepared(model, params, state, dt_))


@jax.jit
def _prepared(model: Model, params: Params, state: State, dt: Array) -> Any:
    return cached(model.replace(cache=None), params, begun(model, params, state, None), dt)


def cached(model: Model, params: Params, state: State, dt: Array) -> Any:
    """What the method prepared, or prepares now; no derivative passes through what changes no solution."""
    if model.cache is not None:
        return jax.lax.stop_gradient(model.cache)
    return prepared(*jax.lax.stop_gradient((model, params, state, dt)))


def rollout(
    model: Model,
    params: Params,
    state: State,
    dt: Any,
    steps: int,
    *,
    every: int = 1,
    forces: Any = None,
    checkpoint: int | None = None,
    on_failure: OnFailure = "continue",
    halvings: int = 3,
) -> tuple[State, StepInfo]:
    """Take `steps` steps of `dt` [s]; returns (states, infos) with a leading axis of the steps // every saved frames.

    Every `every`-th state is saved, and the worst info of the steps since the last. `forces`: (n, 3) constant, or
    (steps, n, 3) [N]. Reverse derivatives of long runs need memory: with `checkpoint` = k (a multiple of `every` that
    divides `steps`) only each step's solution is kept; the rest is recomputed k steps at a time without solving again.
    `on_failure`: a step whose status is not 0, or whose state is not finite, is "continue"d from, or is where the run
    "stop"s: its frame holds that state (`time` says when), later ones repeat it and its status without stepping; or the
    step is taken again in "halve"s, then quarters and so on, `halvings` times before it stops; `info.substeps` counts
    them. Derivatives of all that was before or accepted are as without a failure, those of what a run stopped at zero.
    Lanes of a batch stop on their own. Halves cost reverse derivatives the memory of 2^halvings steps.
    """
    params, state, dt_, forces = typed(model, params, state, dt, forces)
    varying = forces is not None and forces.ndim == 3
    check_call(model, params, state, dt, forces[0] if varying else forces)
    check_rollout(steps, every, checkpoint)
    check_failure(on_failure, halvings)
    if varying and len(forces) != steps:
        raise StepError(f"forces has {len(forces)} rows for {steps} steps")
    tries = {"continue": None, "stop": 0, "halve": halvings}[on_failure]
    saved: tuple[State, StepInfo] = _rollout(model, params, state, dt_, forces, steps, every, checkpoint, tries)
    return saved


@partial(jax.jit, static_argnames=("steps", "every", "checkpoint", "tries"))
def _rollout(
    model: Model,
    params: Params,
    state: State,
    dt: Array,
    forces: Array | None,
    steps: int,
    every: int,
    checkpoint: int | None,
    tries: int | None,
) -> tuple[State, StepInfo]:
    series = None if forces is None or forces.ndim != 3 else forces
    given = value_status(model, params, state, dt, forces if series is None else None)
    state = begun(model, params, state, forces if series is None else series[0])
    cache = cached(model, params, state, dt)  # made once for all steps

    taken = (model, params, dt, forces, cache, given)
    one = one_step(*taken) if tries is None else one_that_ends(*taken, tries)
    carried = state if tries is None else (state, jnp.int32(0))

    def frame(carry: Any, force: Array | None) -> tuple[Any, tuple[State, StepInfo]]:
        following, infos = jax.lax.scan(one, carry, force, length=every)
        return following, (following if tries is None else following[0], worst(infos))

    def block(carry: Any, force: Array | None) -> tuple[Any, tuple[State, StepInfo]]:
        return jax.lax.scan(frame, carry, force, length=(checkpoint or steps) // every)

    per_block = (checkpoint or steps) // every
    blocks = steps // (checkpoint or steps)
    sliced = None if series is None else series.reshape(blocks, per_block, every, *series.shape[1:])
    if checkpoint is None:
        return block(carried, None if sliced is None else sliced[0])[1]
    _, saved = jax.lax.scan(recomputed(block), carried, sliced, length=blocks)
    together: tuple[State, StepInfo]
    together = jax.tree.map(lambda leaf: leaf.reshape(blocks * per_block, *leaf.shape[2:]), saved)
    return together


def one_step(model: Model, params: Params, dt: Array, forces: Array | None, cache: Any, given: Array) -> Any:
    """A step as a scan's body; `given`: the status of the numbers that all steps are given."""

    def one(carry: State, force: Array | None) -> tuple[State, StepInfo]:
        following, info = step_taken(model, params, carry, dt, forces if force is None else force, cache)
        check_memory(model, carry, following)
        return following, judged(info, following, _given(given, force))

    return recomputed(one)


def one_that_ends(
    model: Model, params: Params, dt: Array, forces: Array | None, cache: Any, given: Array, tries: int
) -> Any:
    """A step as a scan's body, that is tried again in halves `tries` times; carries the status that ended the run."""
    advance = forgetting(step_taken)

    def one(carry: tuple[State, Array], force: Array | None) -> tuple[tuple[State, Array], StepInfo]:
        own, force = _given(given, force), forces if force is None else force

        def part(state: State, share: Any) -> tuple[State, StepInfo]:
            following, info = advance(model, params, state, dt * jnp.asarray(share, dt.dtype), force, cache)
            return following, judged(info, following, own)

        info = jax.eval_shape(part, carry[0], 1.0)[1]
        state, failed, told = persistent(recomputed(part), tries, info)(*carry)
        return (state, failed), told

    return one


def _given(given: Array, force: Array | None) -> Array:
    """The status of what a step is given, with the forces of its own."""
    return given if force is None else jnp.where(given != 0, given, force_status(force))


def worst(infos: StepInfo) -> StepInfo:
    """One info for several: the first status that is not 0, the largest of everything else."""
    first = jnp.argmax(infos.status != 0)
    largest: StepInfo = jax.tree.map(lambda leaf: jnp.max(leaf, axis=0), infos)
    return largest.replace(status=infos.status[first])


def joined(before: StepInfo, after: StepInfo) -> StepInfo:
    """`worst` of two."""
    return worst(jax.tree.map(lambda a, b: jnp.stack([a, b]), before, after))
