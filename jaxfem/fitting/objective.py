"""Measured less simulated markers, and its derivatives: compiled once, evaluated many times."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.batching import one_program
from jaxfem.fitting.frames import rigid_fit
from jaxfem.fitting.markers import Markers, marker_frames, marker_places
from jaxfem.fitting.measurement import Measurement
from jaxfem.fitting.paths import Placed, with_all
from jaxfem.fitting.spots import Shift
from jaxfem.fitting.unknowns import DELAY
from jaxfem.materials.constants import Constant
from jaxfem.model import Model, Params, State
from jaxfem.pytrees import Pytree
from jaxfem.stepping.frames import watched
from jaxfem.tensors import contract, matmul

Array = jax.Array


@dataclasses.dataclass(frozen=True)
class Plan:
    """What shapes the compiled program: fitted `constants`, saved `frames`, steps `every` frame, `frame` ("none",
    "all"), `compare`, `free_origin`: whether displacements are compared up to one constant for each marker;
    `at_once`: how many columns of a Jacobian are made side by side, None for all."""

    constants: tuple[Constant, ...]
    frames: int
    every: int
    frame: str
    compare: str
    free_origin: bool = False
    at_once: int | None = None


class Problem(Pytree):
    """Everything else: scene, markers, samples `measured` (T, M, 3) with `weights` (T, M, 3) that are 0 where missing,
    `origin` (M, 3), `times` (T,) in frames since the start, step `dt`; `camera` (3, 4) where they are pixels (u, v, 0),
    None where they are places."""

    model: Model
    params: Params
    state: State
    markers: Markers
    measured: Array
    weights: Array
    origin: Array
    times: Array
    dt: Array
    camera: Array | None = None


class Outcome(Pytree):
    """Side results of an evaluation: `simulated` and `measured` (T, M, 3) in the body's frame, worst `status`."""

    simulated: Array
    measured: Array
    status: Array


def make_problem(
    model: Model,
    params: Params,
    state: State,
    markers: Markers,
    measured: Measurement,
    plan: Plan,
    dt: float,
    sigma: Any,
    camera: Any = None,
) -> Problem:
    """Arrays of the compiled evaluation; `sigma` (M, 3): scale of the residuals [m, or px]."""
    dtype = model.rest.dtype
    weights = np.broadcast_to(measured.seen[..., None], measured.positions.shape).astype(np.float64)
    weights = weights / sigma
    if camera is not None:
        weights[..., 2] = 0.0  # pixels have two coordinates
    cast = [
        jnp.asarray(a, dtype)
        for a in (measured.positions, weights, measured.origin, measured.times / (plan.every * dt), dt)
    ]
    problem = Problem(model, params, state, markers, *cast)
    return problem if camera is None else problem.replace(camera=jnp.asarray(camera, dtype))


@partial(jax.jit, static_argnames="plan")
def residuals(z: Array, problem: Problem, plan: Plan) -> tuple[Array, Outcome]:
    """Weighted residuals (T, M, 3), simulated less measured, zero where a sample is missing, at z (P,)."""
    frames, status = _frames_at(z, problem, plan)
    return difference(z, frames, status, problem, plan)


def compared(params: Params, state: State, problem: Problem, plan: Plan) -> tuple[Array, Outcome]:
    """Weighted residuals of a simulation with these params from this state."""
    frames, status = _simulated_frames(params, state, problem, plan)
    return difference(jnp.zeros(0, problem.dt.dtype), frames, status, problem, plan)


def _values(z: Array, plan: Plan) -> dict[str, Array]:
    return {each.name: each.transform.value(z[i]) for i, each in enumerate(plan.constants)}


def scene_at(z: Array, problem: Problem, plan: Plan) -> tuple[Params, State]:
    """Params and start with the values of z."""
    values = {name: value for name, value in _values(z, plan).items() if name != DELAY.name}
    return with_all(problem.params, problem.state, values, plan.constants)


def _frames_at(z: Array, problem: Problem, plan: Plan) -> tuple[Array, Array]:
    """What is kept of the simulation's frames with the values of z, and the largest status of its steps."""
    return _simulated_frames(*scene_at(z, problem, plan), problem, plan)


def difference(z: Array, kept: Array, status: Array, problem: Problem, plan: Plan) -> tuple[Array, Outcome]:
    """Residuals of what was kept of the frames, the simulation released by the delay [s] in z behind its row, markers
    off their places by its shifts."""
    values = _values(z, plan)
    delay = values.get(DELAY.name, jnp.zeros((), kept.dtype))
    frames = _with_shifts(kept, values, problem, plan)
    simulated = interpolated(frames, problem.times - delay / (plan.every * problem.dt))
    measured, origin = problem.measured, problem.origin
    if plan.frame == "all":
        seen = problem.weights[..., 0].reshape(-1)
        rotation, translation = rigid_fit(measured.reshape(-1, 3), simulated.reshape(-1, 3), seen**2)
        measured = matmul(measured, rotation.T) + translation
        origin = matmul(origin, rotation.T) + translation
    difference = simulated - measured
    if plan.compare == "displacement":
        difference = difference - (frames[0] - origin)
    if plan.free_origin:
        seen = problem.weights > 0
        mean = jnp.sum(jnp.where(seen, difference, 0.0), axis=0) / jnp.maximum(jnp.sum(seen, axis=0), 1)
        difference = difference - mean
    return problem.weights * difference, Outcome(simulated, simulated - difference, status)


@partial(jax.jit, static_argnames="plan")
def linearised(z: Array, problem: Problem, plan: Plan) -> tuple[Array, Array, Outcome]:
    """`residuals` with the Jacobian (P, T, M, 3): the simulation runs once, its tangents side by side. A delay
    and shifts of markers need none: their columns are made of the frames."""
    moving = simulated(plan)
    others = [k for k in range(z.size) if k not in moving]

    def whole(u: Array) -> tuple[Array, tuple[Outcome, Array]]:
        frames, status = _frames_at(u, problem, plan)
        r, outcome = difference(u, frames, status, problem, plan)
        return r, (outcome, frames)

    def tangent(direction: Array) -> tuple[Array, Array, tuple[Outcome, Array]]:
        return jax.jvp(whole, (z,), (direction,), has_aux=True)

    directions = jnp.eye(z.size, dtype=z.dtype)
    if plan.at_once is None or plan.at_once >= len(moving):
        r, columns, (outcome, frames) = jax.vmap(tangent, out_axes=(None, 0, None))(directions[moving])
    else:
        each, columns, aside = jax.lax.map(tangent, directions[moving], batch_size=plan.at_once)
        r, (outcome, frames) = each[0], jax.tree.map(lambda leaf: leaf[0], aside)
    if not others:
        return r, columns, outcome

    def beside(direction: Array) -> Array:
        compare = lambda u: difference(u, frames, outcome.status, problem, plan)[0]  # noqa: E731
        pushed: Array = jax.jvp(compare, (z,), (direction,))[1]
        return pushed

    every = jnp.zeros((z.size, *r.shape), r.dtype).at[moving].set(columns)
    return r, every.at[np.array(others)].set(jax.vmap(beside)(directions[np.array(others)])), outcome


def simulated(plan: Plan) -> np.ndarray:
    """Numbers of the unknowns that a simulation depends on, one at least: neither delays nor shifts of markers."""
    own = [k for k, each in enumerate(plan.constants) if each.name != DELAY.name and shift_of(each) is None]
    return np.array(own or [0])


def shift_of(constant: Constant) -> Shift | None:
    """Which place of which marker a constant shifts; None for what stands in the scene."""
    spot = constant.spot if isinstance(constant, Placed) else None
    return spot if isinstance(spot, Shift) else None


def shift_array(values: dict[str, Array], constants: tuple[Constant, ...], count: int, dtype: Any) -> Array:
    """Shifts (M, 3) [m] of the markers' places."""
    shifts = jnp.zeros((count, 3), dtype)
    for each in constants:
        if (spot := shift_of(each)) is not None:
            shifts = shifts.at[spot.marker, spot.axis].set(values[each.name])
    return shifts


@partial(jax.jit, static_argnames="plan")
def residuals_of_many(z: Array, problem: Problem, plan: Plan) -> tuple[Array, Outcome]:
    """`residuals` at points z (S, P), side by side."""
    found: tuple[Array, Outcome] = jax.vmap(lambda one: residuals(one, problem, plan))(z)
    return found


@partial(jax.jit, static_argnames="plan")
def linearised_of_many(z: Array, problem: Problem, plan: Plan) -> tuple[Array, Array, Outcome]:
    """`linearised` at points z (S, P), side by side."""
    found: tuple[Array, Array, Outcome] = jax.vmap(lambda one: linearised(one, problem, plan))(z)
    return found


@one_program
def interpolated(frames: Array, places: Array) -> Array:
    """Frames (n, ...) at fractional numbers `places` (T,), by Catmull-Rom cubics: exact at whole numbers, smooth
    between.

    Before the first frame and after the last its value is held.
    """
    last = frames.shape[0] - 1
    places = jnp.clip(places, 0.0, float(last))
    whole = jnp.minimum(jnp.floor(places), last - 1).astype(int)
    s = (places - whole).reshape(-1, *[1] * (frames.ndim - 1))
    a, b, c, d = (frames[jnp.clip(whole + k, 0, last)] for k in (-1, 0, 1, 2))
    return b + 0.5 * s * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))


def _with_shifts(kept: Array, values: dict[str, Array], problem: Problem, plan: Plan) -> Array:
    """Where the markers are in the frames, off their places by the shifts; as a camera sees them where there is one."""
    frames = kept[..., :3]
    if kept.shape[-1] > 3:
        turns = kept[..., 3:].reshape(*kept.shape[:-1], 3, 3)
        shifts = shift_array(values, plan.constants, kept.shape[-2], kept.dtype)
        frames = frames + contract("nmij,mj->nmi", turns, shifts)
    return frames if problem.camera is None else pixels(problem.camera, frames)


def keeping(problem: Problem, plan: Plan) -> Callable[[State], Array]:
    """What is kept of a state: where its markers are, and how shifts move them where those may be."""
    shifted = any(shift_of(each) is not None for each in plan.constants)

    def keep(reached: State) -> Array:
        places = marker_places(problem.markers, reached)
        if not shifted:
            return places
        turns = marker_frames(problem.markers, reached)
        return jnp.concatenate([places, turns.reshape(*places.shape[:-1], 9)], axis=-1)

    return keep


def _simulated_frames(params: Params, state: State, problem: Problem, plan: Plan) -> tuple[Array, Array]:
    """Where the markers are in each frame (n, M, 3) up to the last that has a sample: nothing else of the states is
    kept, but (n, M, 12) where markers may be shifted, how that moves them."""
    keep = keeping(problem, plan)
    places, status = watched(
        problem.model,
        params,
        state,
        problem.dt,
        frames_needed(problem, plan),
        plan.every,
        most=plan.frames,
        keep=keep,
    )
    return jnp.concatenate([keep(state)[None], places]), status


def frames_needed(problem: Problem, plan: Plan) -> Array:
    """Frames up to the last sample, with as many behind it as there are behind the recording's last."""
    seen = jnp.any(problem.weights > 0, axis=(1, 2))
    left_out = problem.times[-1] - jnp.max(jnp.where(seen, problem.times, 0.0))
    return jnp.clip(plan.frames - jnp.floor(left_out).astype(jnp.int32), 2, plan.frames)


def pixels(camera: Array, places: Array) -> Array:
    """Where a camera (3, 4) sees places (..., 3) [m]: (u, v, 0) [px] (Hartley & Zisserman 2004, chapter 6)."""
    seen = matmul(places, camera[:, :3].T) + camera[:, 3]
    return jnp.concatenate([seen[..., :2] / seen[..., 2:], jnp.zeros_like(seen[..., :1])], axis=-1)
