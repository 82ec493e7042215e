"""fit and fit_takes: material values of bodies from recordings of their motion, with error bars."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.declared.errors import checked_choice
from jaxfem.fitting.before import clock_faults, outside, refuse, sets_in_motion, start_faults
from jaxfem.fitting.engines import AUTO
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Evaluator, Progress
from jaxfem.fitting.limits import with_limits
from jaxfem.fitting.markers import Markers
from jaxfem.fitting.memory import limit_memory
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.outcome import held_take, result_of
from jaxfem.fitting.priors import Gaussian, checked_priors
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.result import FitResult
from jaxfem.fitting.rounds import judged
from jaxfem.fitting.search import Search
from jaxfem.fitting.sharing import Shared, all_shifts, check_own, shared_unknowns
from jaxfem.fitting.strategy import Strategy, checked_strategy, searched, searching
from jaxfem.fitting.takes import Prepared, Take, checked_takes, compiled_piece, data_beside, prepared
from jaxfem.fitting.unknowns import DELAY
from jaxfem.model import Model, Params, State

CHECKS = ("refuse", "warn")


def fit(
    model: Model,
    params: Params,
    state: State,
    recording: Recording,
    markers: Markers | Mapping[str, Any],
    *,
    dt: float,
    frame: str = "none",
    compare: str = "displacement",
    release: Any = "auto",
    end: Any = None,
    beside: Sequence[Any] = (),
    clamp: Mapping[str, Any] | None = None,
    groups: Mapping[str, Any] | None = None,
    **settings: Any,
) -> FitResult:
    """Recover material values from a recording of markers: values, error bars and what to beware of.

    The simulation starts from `state` at the release, with steps of about `dt` [s] that divide the sample spacing.
    `markers`: attached ones, or places on the body by name [m]. `frame`: "none" (the recording is in the body's frame),
    "rest" (rigid frame from the markers before the release against their places) or "all" (best rigid frame over all
    samples, found again for each trial). `compare`: "displacement" since the release, or "position". `release`: "auto"
    or a time of the recording [s]; `end`: a time, "settled" or None. `beside`, `clamp`, `groups`: see `Take`.
    `settings`: those of `fit_takes`, which fits several recordings at once. FitError for what cannot be fitted.
    """
    more: dict[str, Any] = {"beside": beside, "clamp": clamp, "groups": groups}
    take = Take(model, params, state, recording, markers, dt, frame, compare, release, end, **more)
    return fit_takes([take], **settings)


def fit_takes(
    takes: Sequence[Take],
    *,
    parameters: Sequence[str] | None = None,
    own: Sequence[str] = ("delay",),
    held_out: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    starts: Sequence[Mapping[str, float]] | None = None,
    noise: Noise | None = None,
    sigma: Any = None,
    priors: Mapping[str, Any] | None = None,
    search: Search | None = None,
    progress: Progress | None = None,
    checks: str = "refuse",
    multi_start: int = 0,
    seed: int = 0,
    windows: int = 1,
    max_memory: float | None = None,
    places: float | None = None,
    engine: str = AUTO,
) -> FitResult:
    """Recover values that several recordings share, and those that each has for itself.

    The unknowns `parameters` (constants of the bodies' materials, like "young" [Pa], "poisson" and "damping" [s]: all
    when None; "density" [kg/m^3]; "delay" [s] of the release behind its row; what has a path, like
    "contact.floor.friction", see `fitting/paths.py`) start at their values in the scene, or at
    each of `starts`; these may be far off (a factor of 30 is fine). Those in `own` each take has for itself, as
    NAME_TAKE; the others are the same in all. Takes named in `held_out` are not fitted but predicted, and scored in
    the same table; what they have for themselves is fitted to them alone. `bounds`: name -> (lowest, highest);
    `priors`: name -> `Gaussian` or `LogNormal`. `noise`: see `Noise`; `sigma` for short.
    `checks`: before the search recordings are looked at, wrong samples are left out (`FitResult.repairs` says which)
    and what cannot be right is refused; "warn" goes on and makes it a warning.
    `multi_start`: so many starts are drawn with `seed` beside those given, and followed side by side;
    `FitResult.ends` says where each led. `windows`: each take is fitted from its beginning on in windows that grow, so
    many in all: for long recordings of what touches. `max_memory` [GB]: of one simulation with derivatives.
    `places` [m]: to which the markers' places on the body are known; their shifts, marker.NAME.x and so on, are then
    found with the rest, with that as their prior. `engine`: how simulations are made, "auto" or one of
    `fitting.engines.ENGINES`; `FitResult.engine` and `.reason` say which it was, and why.
    `progress(stage, iteration, loss, values)` is called after each simulation. Ctrl-C returns the best so far.

    Residuals are smoothed over time, less and less, and minimised by Levenberg-Marquardt steps (Levenberg 1944,
    Marquardt 1963) with forward-mode Jacobians from a scan over the stiffness, such as Young's modulus. FitError for
    what cannot be fitted.
    """
    noise = _noise(noise, sigma)
    checked_takes(takes)
    out = _held_out(takes, held_out)
    evaluator, made, shared = assembled(
        [take for take in takes if take.name not in out], parameters, own, starts, bounds, noise, priors, checks, places
    )
    evaluator.progress = progress
    settings = search or Search()
    strategy = checked_strategy(
        Strategy(settings, windows, multi_start, seed), [len(each.measured.times) for each in made]
    )
    limit_memory(evaluator, max_memory)
    reason = evaluator.take(engine, multi_start)
    late = _late(parameters)
    held = [prepared(take, checks, late) for take in takes if take.name in out]
    usual = usual_scales(made)
    frames = [each.take.frame for each in made]
    faults = [text for each in (*made, *held) for text in each.faults]
    coarse, cut = searching(evaluator), [each.measured for each in made]
    faults += refuse(start_faults(coarse, shared.starts[0], cut, frames), checks)
    faults += refuse(clock_faults(coarse, shared.starts[0], cut), checks)
    z, status, ends = searched(evaluator, coarse, shared, strategy)
    try:
        best = judged(evaluator, made, z, noise, settings.polish if status == "converged" else 0, settings.tol)
        evaluator.stage = "error bars"
        told = [held_take(each, shared, best, noise, usual, parameters, own) for each in held]
    except KeyboardInterrupt:  # the search is done: what it found is not lost
        best, told, status = judged(evaluator, made, z, noise, 0, settings.tol), [], "interrupted"
    repairs = [text for each in (*made, *held) for text in each.notes] + outside(made[0].params, shared.unknowns)
    found = result_of(evaluator, made, shared, best, noise, told, status, faults, repairs, ends)
    found = dataclasses.replace(found, engine=evaluator.pieces[0].engine.name, reason=reason)
    if status == "interrupted":
        return found
    try:
        return with_limits(found)
    except KeyboardInterrupt:
        return dataclasses.replace(found, status="interrupted")


def assembled(
    takes: Sequence[Take],
    parameters: Sequence[str] | None,
    own: Sequence[str],
    starts: Sequence[Mapping[str, float]] | None,
    bounds: Mapping[str, tuple[float, float]] | None,
    noise: Noise,
    priors: Mapping[str, Any] | None,
    checks: str,
    places: float | None = None,
) -> tuple[Evaluator, list[Prepared], Shared]:
    """What is evaluated of takes: checked, cut, with their unknowns."""
    checked_choice("checks", checks, CHECKS, FitError)
    checked_takes(takes)
    late = _late(parameters)
    made = [prepared(take, checks, late) for take in takes]
    shifts = () if places is None else all_shifts(made)
    shared = shared_unknowns(made, parameters, own, starts, bounds, shifts)
    check_own(own, shared)
    priors = {**{name: _place_prior(places) for name in shifts}, **dict(priors or {})}
    usual = usual_scales(made)
    pieces = [
        compiled_piece(each, shared.unknowns, shared.own[k], noise, usual[each.unit]) for k, each in enumerate(made)
    ]
    data = [one for k, each in enumerate(made) for one in data_beside(each, shared.unknowns, shared.own[k])]
    known = checked_priors(shared.unknowns, priors, data)
    for one in data:
        if not np.isfinite(one.rows(shared.starts[0])[0]).all():
            raise FitError(
                f"{one.what.title} beside the markers: the scene cannot tell it at the start values (no equilibrium, "
                "or modes that do not converge): see that the body is held, and start from stiffer values"
            )
    return Evaluator(pieces, shared.unknowns, None, known, 1.0 if noise.known else 1e-4), made, shared


def _late(parameters: Sequence[str] | None) -> bool:
    """Whether what is fitted changes how, or when, the motion begins."""
    names = [parameters] if isinstance(parameters, str) else list(parameters or ())
    return DELAY.name in names or sets_in_motion(names)


def _place_prior(places: Any) -> Gaussian:
    if isinstance(places, bool) or not isinstance(places, int | float) or not 0 < places < np.inf:
        raise FitError(f"places is {places!r}: give the length in m to which markers' places are known, like 1e-3")
    return Gaussian(0.0, float(places))


def usual_scales(made: Sequence[Prepared]) -> dict[str, float]:
    """Scale of residuals by their unit, where nothing else is said."""
    return {unit: _usual_scale([each for each in made if each.unit == unit]) for unit in ("m", "px")}


def _noise(noise: Noise | None, sigma: Any) -> Noise:
    if noise is not None and sigma is not None:
        raise FitError("sigma is given beside noise: give it within, Noise(sigma=...)")
    return noise if noise is not None else Noise(sigma=sigma)


def _held_out(takes: Sequence[Take], held_out: Sequence[str]) -> tuple[str, ...]:
    out = (held_out,) if isinstance(held_out, str) else tuple(held_out)
    names = [take.name for take in takes]
    for name in out:
        if name not in names:
            raise FitError(f'held_out names no take "{name}"; takes: {", ".join(names)}')
    if names and len(out) == len(names):
        raise FitError("all takes are held out: leave one to be fitted")
    return out


def _usual_scale(made: Sequence[Any]) -> float:
    """Root mean square motion of all takes: one for all, since their cameras scatter alike."""
    return float(np.sqrt(np.mean([each.measured.displacement_scale**2 for each in made]))) if made else 1.0
