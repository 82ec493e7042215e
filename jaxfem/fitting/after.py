"""After a fit: profile likelihoods, and what uncertain marker places and held values add (Type B, JCGM 100:2008)."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.building import rebuild
from jaxfem.fitting.asked import Contribution, Profile
from jaxfem.fitting.climbing import levenberg_marquardt
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Evaluator, Progress
from jaxfem.fitting.markers import moved_markers
from jaxfem.fitting.paths import placed_constants, value_of, with_all
from jaxfem.fitting.result import FitResult

EDGE = 3.841458820694124  # -2 log likelihood ratio at which a 95 % interval of one parameter ends (chi^2, one degree)
STEPS = 24


def profile(result: FitResult, name: str, progress: Progress | None = None) -> Profile:
    """The profile likelihood of one parameter (Venzon & Moolgavkar 1988), of samples and priors.

    The noise's variance is profiled with the others; where noise remembers, its curvature is that of the error bar.
    `progress` as in `fit_takes`.
    FitError for a name that was not fitted.
    """
    evaluator, best = result.solved(progress)
    if name not in evaluator.unknowns.names:
        raise FitError(f'"{name}" was not fitted; fitted: {", ".join(evaluator.unknowns.names)}')
    place = evaluator.unknowns.names.index(name)
    bar = float(np.sqrt(best.uncertainty.covariance[place, place]))
    evaluator.stage = "profile"
    points = [(float(best.z[place]), 0.0)]
    ends = [_side(evaluator, best, place, sign * bar, points) for sign in (-1.0, 1.0)]
    points.sort()
    transform = evaluator.unknowns.constants[place].transform
    values = [float(transform.value(jnp.asarray(z))) for z, _ in points]
    low, high = (None if end is None else float(transform.value(jnp.asarray(end))) for end in ends)
    interval = (-np.inf if low is None else low, np.inf if high is None else high)
    return Profile(name, np.array(values), np.array([drop for _, drop in points]), interval)


def _side(evaluator: Evaluator, best: Any, place: int, step: float, points: list[tuple[float, float]]) -> float | None:
    """Where the ratio passes its edge on one side, None where it does not before the bound."""
    low, high = (float(bound[place]) for bound in evaluator.unknowns.box)
    free = np.arange(best.z.size) != place
    least = _misfit(evaluator, best, best.z)
    known = _known(evaluator, best.z)
    z, last = best.z.copy(), (float(best.z[place]), 0.0)

    def looked(at: float) -> tuple[float, float]:
        z[place] = at
        if free.any():
            z[:], _ = levenberg_marquardt(evaluator, z, 6, best.weighting, chosen=free, tol=1e-6)
        gained = _known(evaluator, z) - known
        points.append((at, best.uncertainty.drop(_misfit(evaluator, best, z), least, place, gained)))
        return points[-1]

    longest = evaluator.unknowns.constants[place].transform.open_spread
    step = float(np.clip(step, -longest, longest))
    for _ in range(STEPS):
        there = looked(float(np.clip(last[0] + step, low, high)))
        if there[1] >= EDGE:
            return _crossing(looked, last, there)
        if there[0] in (low, high):
            return None
        last = there
        step *= 1.0 if there[1] > 0.5 else 1.5
    return None


def _crossing(
    looked: Callable[[float], tuple[float, float]], inside: tuple[float, float], beyond: tuple[float, float]
) -> float:
    """Where the ratio passes its edge between two points (z, drop), by false position on its root."""
    for _ in range(4):
        if beyond[1] < 1.5 * EDGE:
            break
        there = looked(_between(inside, beyond))
        inside, beyond = (inside, there) if there[1] >= EDGE else (there, beyond)
    return _between(inside, beyond)


def _between(inside: tuple[float, float], beyond: tuple[float, float]) -> float:
    a, b = (float(np.sqrt(max(drop, 0.0))) for _, drop in (inside, beyond))
    return inside[0] + (float(np.sqrt(EDGE)) - a) / (b - a) * (beyond[0] - inside[0])


def _known(evaluator: Evaluator, z: np.ndarray) -> float:
    """Sum of squares of the priors' rows, in standard deviations."""
    return 0.0 if evaluator.priors is None else float(np.sum(evaluator.priors.rows(z)[0] ** 2))


def _misfit(evaluator: Evaluator, best: Any, z: np.ndarray) -> float:
    flat = best.weighting.residual(evaluator.residual(z)[0])
    return float(flat @ flat)


def contributions(
    result: FitResult,
    held: Mapping[str, float] | None = None,
    places: float | None = None,
    geometry: float | None = None,
    progress: Progress | None = None,
) -> list[Contribution]:
    """The Type B list of a fit: `held`, name of a constant that was not fitted -> its relative standard uncertainty
    (density: 0.01); `places`: that of each marker's place on the body [m]; `geometry`: that of the soft bodies' size
    along each axis, as a share of it.

    By sensitivities at the solution: the shift of the least-squares solution where residuals change by dr is
    -(J'J)^-1 J' dr. Markers are off independently of each other. FitError for a constant that the scene lacks or the
    fit found.
    """
    evaluator, best = result.solved(progress)
    residual, jacobian, _ = evaluator.linear(best.z)
    known = evaluator.priors  # its rows stand beside the samples', in standard deviations as these
    own, slope = known.rows(best.z) if known is not None else (np.zeros(0), np.zeros((0, best.z.size)))
    base = np.concatenate([best.weighting.residual(residual), own])
    columns = np.concatenate([best.weighting.columns(jacobian), slope.T], axis=1)
    solve = np.linalg.pinv(columns @ columns.T) @ columns
    slopes = evaluator.unknowns.slopes(best.z)
    names = evaluator.unknowns.names

    def moved(changed: Evaluator) -> np.ndarray:
        told = best.weighting.residual(changed.residual(best.z)[0])
        told = np.concatenate([told, changed.priors.rows(best.z)[0] if changed.priors is not None else own])
        return np.asarray(-solve @ (told - base) * slopes)

    found = []
    for name, share in dict(held or {}).items():
        found.append(Contribution(name, f"{100 * share:g} %", _named(names, moved(_scaled(evaluator, name, share)))))
    if places is not None:
        square = sum(moved(each) ** 2 for each in _moved_markers(evaluator, places))
        found.append(Contribution("marker places", f"{1e3 * places:g} mm each", _named(names, np.sqrt(square))))
    if geometry is not None:
        for k, axis in enumerate("xyz"):
            change = _named(names, moved(_stretched(evaluator, geometry, k)))
            found.append(Contribution(f"size along {axis}", f"{100 * geometry:g} %", change))
    return found


def _scaled(evaluator: Evaluator, name: str, share: float) -> Evaluator:
    """The fit with a held constant changed by a share of itself."""
    if name in evaluator.unknowns.names:
        raise FitError(f"{name} was fitted: its uncertainty is in its error bar")

    def scaled(at: Any) -> dict[str, Any]:
        model, params, state = at.model, at.params, at.state
        known = {**model.constants, **placed_constants(model, params, state)}
        if name not in known:
            raise FitError(f'the scene has no constant "{name}"; it has {", ".join(model.constants)}')
        value = jnp.asarray(value_of(known[name], params, state) * (1 + share), model.rest.dtype)
        changed = with_all(params, state, {name: value}, (known[name],))
        return dict(zip(("params", "state"), changed, strict=True))

    return _changed(evaluator, scaled)


def _stretched(evaluator: Evaluator, share: float, axis: int) -> Evaluator:
    """The fit with soft bodies longer along an axis, about their middle; markers and loads ride along."""

    def longer(at: Any) -> dict[str, Any]:
        model, state, markers = at.model, at.state, at.markers
        along = model.rest[:, axis]
        rest = model.rest.at[:, axis].add(share * (along - 0.5 * (along.min() + along.max())))
        moved = state.replace(positions=state.positions + (rest - model.rest))
        return {"model": rebuild(model, rest), "state": moved, "markers": markers.reshaped(rest)}

    return _changed(evaluator, longer)


def _changed(evaluator: Evaluator, change: Callable[[Any], dict[str, Any]]) -> Evaluator:
    """The fit with other fields, `change` of a problem or of data beside markers, of every scene in it."""
    pieces = [piece.on(piece.problem.replace(**change(piece.problem))) for piece in evaluator.pieces]
    priors = evaluator.priors
    if priors is not None:
        data = tuple(each.on(**change(each.aside)) for each in priors.data)
        priors = dataclasses.replace(priors, data=data)
    return Evaluator(pieces, evaluator.unknowns, evaluator.progress, priors)


def _moved_markers(evaluator: Evaluator, places: float) -> list[Evaluator]:
    """The fit with one marker, of one take, one axis, off its place at a time."""
    found = []
    for k, piece in enumerate(evaluator.pieces):
        markers, model = piece.problem.markers, piece.problem.model
        for marker in range(markers.count):
            for axis in range(3):
                off = np.zeros((markers.count, 3))
                off[marker, axis] = places
                changed = piece.problem.replace(markers=moved_markers(markers, model, off))
                pieces = list(evaluator.pieces)
                pieces[k] = piece.on(changed)
                found.append(Evaluator(pieces, evaluator.unknowns, evaluator.progress))
    return found


def _named(names: tuple[str, ...], shift: np.ndarray) -> dict[str, float]:
    return dict(zip(names, shift.tolist(), strict=True))
