"""Checks before the search: what cannot be right is refused with its cause, in words.

First what the recording says by itself, against the given places and the scene's loads; then one linearised simulation
at the start: does the body move the way that was recorded, does every parameter move the markers, and can they be told
apart at all.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.clipped import end_faults
from jaxfem.fitting.clock_checks import jump_faults, pace_faults, pauses_in_words
from jaxfem.fitting.course_checks import course_faults, rigid_faults
from jaxfem.fitting.direction_checks import direction_faults
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import BROKEN, Evaluator, Piece
from jaxfem.fitting.markers import Markers, carried
from jaxfem.fitting.measurement import Measurement
from jaxfem.fitting.objective import pixels
from jaxfem.fitting.place_checks import pixel_faults, place_faults
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.search import as_far
from jaxfem.fitting.start_checks import (
    again_faults,
    bounce_faults,
    camera_faults,
    late_faults,
    leap_faults,
    release_faults,
)
from jaxfem.fitting.swings import swing_faults
from jaxfem.fitting.unknowns import Unknowns
from jaxfem.materials.constants import Constant
from jaxfem.model import Model, Params, State, nodal_mass
from jaxfem.solvers import Status
from jaxfem.system.soft import external_force

BEGINNINGS = ("load", "gravity", "velocity", "spin", "place", "turn", "motion")
"""First words of paths of what sets bodies in motion."""


def sets_in_motion(names: Sequence[str]) -> bool:
    """Whether one of the fitted `names` says how the motion begins."""
    return any(name.split(".")[0] in BEGINNINGS for name in names)


def refuse(faults: Sequence[str], checks: str) -> list[str]:
    """FitError of all faults; with checks = "warn" they come back, for the warnings."""
    if faults and checks == "refuse":
        listed = "; ".join(faults)
        raise FitError(f'the recording and the scene do not fit together. {listed}. (checks = "warn" goes on anyway)')
    return list(faults)


def written_faults(
    recording: Recording,
    measured: Measurement,
    nominal: np.ndarray,
    model: Model,
    params: Params,
    state: State,
    frame: str,
    compare: str,
    late: bool = False,
    release: Any = "auto",
) -> tuple[list[str], list[str]]:
    """(faults, notes) of the recording as it stands, without a simulation; `late`: whether what is
    fitted changes how, or when, the motion begins; `release` as in `fit`."""
    if recording.camera is not None:
        nominal = np.asarray(pixels(jnp.asarray(recording.camera), jnp.asarray(nominal)))
        faults = pixel_faults(measured.stood, nominal, recording.names)
        return [*faults, *jump_faults(recording), *pace_faults(recording, None)], pauses_in_words(recording)
    moved = float(np.abs(measured.positions - measured.origin)[measured.seen].max())
    faults, notes = place_faults(measured.stood, nominal, recording.names, frame, compare, moved)
    if not faults:
        faults = [*jump_faults(recording), *pace_faults(recording, load_acceleration(model, params, state))]
    if not faults:
        faults = [
            *camera_faults(recording, is_held(model)),
            *([*again_faults(recording, measured), *leap_faults(measured, recording.names)] if is_held(model) else []),
        ]
    from_rest = falling(model, params, state, late)
    if not faults and from_rest and not isinstance(release, str):
        faults = release_faults(recording, measured, float(release))
    if not faults:
        faults = late_faults(measured, from_rest)
    return faults, [*notes, *pauses_in_words(recording)]


def looked_through(
    recording: Recording,
    markers: Markers,
    nominal: np.ndarray,
    model: Model,
    params: Params,
    frame: str,
    within: tuple[float, float],
) -> tuple[list[str], list[str]]:
    """(faults, notes) of the course of the motion `within` two times [s], where the body is held, rigid, or falls."""
    rows = (recording.times >= within[0]) & (recording.times <= within[1])
    if rows.sum() < 2:
        return [], []
    part = dataclasses.replace(recording, times=recording.times[rows], positions=recording.positions[rows])
    if not is_held(model):
        faults = rigid_faults(part, carried(markers))
        return [*faults, *bounce_faults(part, alone(model, params, frame))], []
    if faults := end_faults(part):
        return faults, []
    held = np.asarray(model.rest)[np.asarray(model.free) == 0]
    return course_faults(part, nominal, held.mean(axis=0), not model.has_memory)


def alone(model: Model, params: Params, frame: str) -> np.ndarray:
    """Gravity (3,) [m/s^2] in the frame of a recording where nothing else drives the scene; zeros else, and where the
    frame is not known."""
    driven = bool(model.driven) or bool(model.joints) or any(np.asarray(value).any() for value in params.loads)
    if model.rigid is not None:
        driven = driven or bool(np.asarray(model.rigid.driven).size)
    return np.zeros(3) if driven or frame != "none" else np.asarray(params.gravity, np.float64)


def load_acceleration(model: Model, params: Params, state: State) -> float | None:
    """Acceleration [m/s^2] of a soft body at rest by its loads alone, over all of it; None where something else moves
    it: driven nodes, joints, contacts, a velocity or a shape it starts with."""
    driven = bool(model.driven) or bool(model.joints) or bool(model.contacts) or model.rigid is not None
    if driven or np.asarray(state.velocities).any() or not np.allclose(state.positions, model.rest, rtol=0, atol=1e-9):
        return None
    if not model.loads:
        return float(np.linalg.norm(params.gravity))
    force = external_force(model, params, state.positions)
    return float(jnp.linalg.norm(force.sum(axis=0)) / nodal_mass(model, params.density).sum())


def is_held(model: Model) -> bool:
    """Whether all soft bodies have fixed nodes, and nothing else moves or strikes them."""
    if model.coupled or len(model.driven) or not model.bodies:
        return False
    owner, fixed = np.asarray(model.node_body), np.asarray(model.free) == 0
    return all(fixed[owner == number].any() for number in range(len(model.bodies)))


def falling(model: Model, params: Params, state: State, late: bool) -> float | None:
    """Gravity [m/s^2] where it alone sets soft bodies in motion; None else, or where `late` says so."""
    if late or any(np.asarray(value).any() for value in params.loads):
        return None
    return load_acceleration(model, params, state)


def start_faults(
    evaluator: Evaluator, z: np.ndarray, measured: Sequence[Measurement], frames: Sequence[str]
) -> list[str]:
    """What one linearised simulation of each take at the start z shows; nothing where one breaks down, which the search
    may mend."""
    faults, columns, size = [], [], 0.0
    turned = sets_in_motion(evaluator.unknowns.names)
    for piece, taken, frame in zip(evaluator.pieces, measured, frames, strict=True):
        residual, own, outcome = piece.linearised(z)
        jacobian = np.zeros((z.size, residual.size))
        jacobian[piece.columns] = np.asarray(own, np.float64).reshape(len(piece.columns), -1)
        if Status(int(outcome.status)) in BROKEN or not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
            return []
        simulated = np.asarray(outcome.simulated, np.float64)
        told = simulated * np.asarray(piece.problem.weights, np.float64)  # in the residual's unit
        size += float(((told - told.mean(axis=0)) ** 2).sum())
        columns.append(jacobian)
        coupled = piece.problem.model.coupled  # what bounces or swings may be anywhere, with values that are off
        if frame != "all" and not coupled:
            names, model = piece.problem.markers.names, piece.problem.model
            unit = "m" if piece.problem.camera is None else "px"
            alike = len(model.bodies) == 1 and not any("." in each for each in evaluator.unknowns.names)
            faults += direction_faults(simulated, taken, names, piece.plan.compare, not turned, alike, unit)
    joined = np.concatenate(columns, axis=1)
    if evaluator.priors is not None:
        prior = evaluator.variance**0.5 * evaluator.priors.rows(z)[1].T
        joined = np.concatenate([joined, prior], axis=1)
    eps = float(jnp.finfo(evaluator.pieces[0].problem.model.rest.dtype).eps)
    return faults + open_faults(joined, evaluator.unknowns, size**0.5, eps)


def clock_faults(evaluator: Evaluator, start: np.ndarray, measured: Sequence[Measurement]) -> list[str]:
    """What simulations say of the clock where bodies sink about as far as was measured: from a start (P,) on, in the
    search's own first steps, which it need not make again."""
    faults, turned = list[str](), sets_in_motion(evaluator.unknowns.names)
    axis = evaluator.unknowns.scanned
    if axis is None or not any(_swings_freely(piece, turned) for piece in evaluator.pieces):
        return faults
    z = as_far(evaluator, start, axis)
    if z is None:
        return faults
    outcomes = evaluator.residual(z)[1]
    for piece, taken, outcome in zip(evaluator.pieces, measured, outcomes, strict=True):
        if Status(int(outcome.status)) not in BROKEN and _swings_freely(piece, turned):
            simulated, dt = np.asarray(outcome.simulated, np.float64), float(piece.problem.dt)
            faults += swing_faults(simulated, taken, dt, piece.problem.model.scheme.order)
    return faults


def _swings_freely(piece: Piece, turned: bool) -> bool:
    """Whether displacements are compared of an elastic body that is held, and let go under its own weight."""
    problem, model = piece.problem, piece.problem.model
    from_rest = (
        is_held(model)
        and len(model.bodies) == 1
        and not model.has_memory
        and falling(model, problem.params, problem.state, turned)
    )
    return bool(from_rest) and problem.camera is None and piece.plan.compare == "displacement"


def open_faults(columns: np.ndarray, unknown: Unknowns, size: float, eps: float) -> list[str]:
    """Parameters that move nothing, and combinations that nothing tells apart, by the Jacobian (P, N) of the unknowns.

    `size`: of the motion, in the residual's unit; `eps` of the arithmetic.
    """
    norms = np.linalg.norm(columns, axis=1)
    blind = norms <= 100 * eps * max(size, norms.max())
    faults = [
        f"{each.title} ({each.name}): changing it moves no marker in these samples, so it cannot be found from them: "
        "leave it out of parameters, or start where it does (what yields: below what the body reaches)"
        for each, nothing in zip(unknown.constants, blind, strict=True)
        if nothing
    ]
    left = np.flatnonzero(~blind)
    if left.size < 2:
        return faults
    scaled = columns[left] / norms[left][:, None]
    _, sizes, shapes = np.linalg.svd(scaled @ scaled.T)
    null = shapes[sizes < eps**0.8 * sizes[0]] / norms[left]
    if len(null):
        faults.append(combinations_in_words([unknown.constants[k] for k in left], null))
    return faults


def combinations_in_words(constants: Sequence[Constant], null: np.ndarray) -> str:
    """What can be found where the directions `null` (k, P) of z change nothing.

    With logarithms as unknowns a direction of (1, 1) leaves the ratio of two constants, one of (1, -1) their product.
    """
    share = np.abs(null).max(axis=0) / np.abs(null).max()
    within = [k for k in range(len(constants)) if share[k] > 1e-3]
    names = [constants[k].name for k in within]
    logarithmic = all(constants[k].transform.proportional for k in within)
    cure = f"hold {' or '.join(names)} fixed, or add a recording that tells them apart"
    if len(null) == 1 and len(within) == 2 and logarithmic:
        a, b = (float(null[0, k]) for k in within)
        power = -a / b  # z_a + power z_b does not change along the direction
        times = "/" if power < 0 else "*"
        other = names[1] if abs(abs(power) - 1) < 0.02 else f"{names[1]}^{abs(power):.2g}"
        return f"only {names[0]}{times}{other} can be found from this recording: {cure}"
    count = len(within) - len(null)
    number = "no combination" if count == 0 else f"only {count} combination{'s' if count > 1 else ''}"
    return f"{number} of {', '.join(names)} can be found from this recording: {cure}"


def outside(params: Params, unknown: Unknowns) -> list[str]:
    """The scene's own values that had to be moved inside the bounds to start from."""
    notes = []
    for each, low, high in zip(unknown.constants, unknown.lower, unknown.upper, strict=True):
        if each.name not in params.constants:
            continue
        value = float(np.mean(np.asarray(params.constants[each.name])))
        if not low <= value <= high and value > 0:
            inside = float(np.clip(value, low, high))
            notes.append(f"{each.name} of the scene, {value:.4g}, is outside the bounds: the start is {inside:.4g}")
    return notes
