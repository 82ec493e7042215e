"""fit: material values of a body from a recording of its motion, with error bars."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.declared.errors import checked_choice
from jaxfem.fitting.advice import advice, text_of
from jaxfem.fitting.before import outside, refuse, start_faults, written_faults
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Evaluator, Progress, Visit
from jaxfem.fitting.markers import Markers, attach, marker_positions
from jaxfem.fitting.measurement import Measurement, measurement
from jaxfem.fitting.objective import Outcome, Plan, make_problem
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.repairs import repaired
from jaxfem.fitting.search import Search, find, levenberg_marquardt
from jaxfem.fitting.statistics import Uncertainty, uncertainty
from jaxfem.fitting.unknowns import (
    DELAY,
    Unknowns,
    chosen,
    known_constants,
    start_values,
    unknowns,
    usual_names,
    with_values,
)
from jaxfem.materials.constants import Constant
from jaxfem.model import Model, Params, State
from jaxfem.stepping import check_call, typed

CHECKS = ("refuse", "warn")
MANY_SUBSTEPS = 3  # from here on, the search takes one step a sample and only the polish all of them


@dataclasses.dataclass(frozen=True)
class FitResult:
    """What a fit found.

    `constants`: those fitted, with their units; `values` and `standard_errors` by their names (Pa, s, kg/m^3);
    `correlation` (P, P) in the order of `values`; `params`: the scene's with the values in; `loss`: mean square
    residual over sigma^2, or over the mean square motion where no sigma was given; `noise` [m]: root mean square
    residual of a coordinate; `times` (T,) [s] since the release at `release` [s] of the recording, which lies in
    `release_interval` [s] with 95 %; `residuals` (simulated less measured, NaN where missing), `simulated`, `measured`
    (T, M, 3) [m] in the body's frame; `markers`: names; `history`: every evaluation; `status`: "converged", "iteration
    limit", "steps failed" or "interrupted"; `warnings`: what may make the values wrong; `repairs`:
    what was left out, repaired or noticed in the recording; `unit`: "m", or "px" where residuals and places are pixels.
    """

    constants: tuple[Constant, ...]
    values: dict[str, float]
    standard_errors: dict[str, float]
    correlation: np.ndarray
    params: Params
    loss: float
    noise: float
    times: np.ndarray
    release: float
    release_interval: tuple[float, float]
    residuals: np.ndarray
    simulated: np.ndarray
    measured: np.ndarray
    markers: tuple[str, ...]
    history: tuple[Visit, ...]
    status: str
    warnings: tuple[str, ...]
    repairs: tuple[str, ...] = ()
    unit: str = "m"

    def summary(self) -> str:
        """Values with error bars, the misfit and all warnings, as text."""
        shown = f"{1e3 * self.noise:.3g} mm" if self.unit == "m" else f"{self.noise:.3g} {self.unit}"
        lines = [text_of(self.constants, self.values, self.standard_errors)]
        lines.append(
            f"  residual {shown} rms a coordinate, {len(self.times)} samples of {len(self.markers)} "
            f"markers from {self.release:g} s on; {self.status}, {len(self.history)} simulations"
        )
        lines += [f"  recording: {text}" for text in self.repairs]
        lines += [f"  warning: {text}" for text in self.warnings]
        return "\n".join(lines)


def fit(
    model: Model,
    params: Params,
    state: State,
    recording: Recording,
    markers: Markers | Mapping[str, Any],
    *,
    parameters: Sequence[str] | None = None,
    dt: float,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    starts: Sequence[Mapping[str, float]] | None = None,
    frame: str = "none",
    compare: str = "displacement",
    release: Any = "auto",
    end: Any = None,
    sigma: Any = None,
    search: Search | None = None,
    progress: Progress | None = None,
    checks: str = "refuse",
) -> FitResult:
    """Recover material values from a recording of markers: values, error bars and what to beware of.

    The simulation starts from `state` at the release, with steps of about `dt` [s] that divide the sample spacing. The
    unknowns `parameters` (constants of the bodies' materials, like "young" [Pa], "poisson" and "damping" [s]: all of
    them when None; "density" [kg/m^3]; "delay" [s] of the release behind its row) start at their values in `params`, or
    at each of `starts`; these may be far off (a factor of 30 is fine). `bounds`: name -> (lowest, highest). `markers`:
    attached ones, or places on the body by name [m].

    `frame`: "none" (the recording is in the body's frame), "rest" (rigid frame from the markers before the release
    against their places) or "all" (best rigid frame over all samples, found again for each trial). `compare`:
    "displacement" since the release, or "position". `release`: "auto" or a time of the recording [s]; `end`: a time,
    "settled" or None. `sigma`: scatter of the samples [m], one number, one a marker or (M, 3).
    `checks`: before the search the recording is looked at, wrong samples are left out (`FitResult.repairs` says which)
    and what cannot be right is refused; "warn" goes on and makes it a warning.
    `progress(stage, iteration, loss, values)` is called after each simulation. Ctrl-C returns the best so far.

    Residuals are smoothed over time, less and less, and minimised by Levenberg-Marquardt steps (Levenberg 1944,
    Marquardt 1963) with forward-mode Jacobians from a scan over the stiffness, such as Young's modulus. FitError for
    what cannot be fitted.
    """
    params, state = typed(model, params, state)  # plain numbers are fine, as in `step`
    check_call(model, params, state, dt)
    markers = markers if isinstance(markers, Markers) else attach(model, markers)
    checked_choice("checks", checks, CHECKS, FitError)
    recording = repaired(recording.subset(markers.names))
    nominal = np.asarray(marker_positions(markers, state.positions), np.float64)
    measured = measurement(recording, nominal, frame=frame, compare=compare, release=release, end=end)
    faults, notes = written_faults(recording, measured, nominal, model, params, state, frame, compare)
    faults = refuse(faults, checks)
    unknown, free_starts = _unknowns(model, params, parameters, starts, bounds, measured.spacing)
    plan, dt = _plan(unknown, measured, dt, frame, compare)
    problem = make_problem(model, params, state, markers, measured, plan, dt, sigma, recording.camera)
    evaluator = Evaluator(problem, plan, unknown, progress)
    faults += refuse(start_faults(_searching(evaluator), free_starts[0], measured, frame), checks)
    z, status = _searched(evaluator, free_starts, search or Search())
    evaluator.stage = "error bars"
    residual, jacobian, outcome = evaluator.linear(z)
    axes = 2 if recording.unit == "px" else 3
    constants = 6 * (frame == "all") + axes * len(markers.names) * measured.free_origin
    pinned = measured.still_rows if compare == "displacement" and not measured.free_origin else None
    spread = uncertainty(residual, jacobian, measured.seen, pinned, constants, axes)
    values = {name: _cast(value, params) for name, value in unknown.values(z).items() if name != DELAY.name}
    found = with_values(params, values, unknown.constants)
    simulated = np.asarray(outcome.simulated, np.float64)
    warnings = advice(
        model, found, unknown, z, spread, measured, simulated, dt, int(outcome.status != 0) and evaluator.step_failures
    )
    warnings = (*faults, *warnings)
    repairs = (*recording.notes, *notes, *outside(params, unknown))
    if status == "converged" and int(outcome.status) != 0:
        status = "steps failed"
    return _result(evaluator, z, spread, outcome, found, measured, status, warnings, repairs)


def _unknowns(
    model: Model, params: Params, names: Sequence[str] | None, starts: Any, bounds: Any, spacing: float
) -> tuple[Unknowns, list[np.ndarray]]:
    scene = model.constants.values()
    names = (names,) if isinstance(names, str) else tuple(usual_names(scene) if names is None else names)
    constants = chosen(names, known_constants(scene))
    own = start_values(params, constants, spacing)
    given = [{**own, **dict(each)} for each in (starts or [{}])]
    for each in given:
        strange = [name for name in each if name not in names]
        if strange:
            raise FitError(f'a start is given for "{strange[0]}", which is not fitted; fitted: {", ".join(names)}')
        for constant in constants:
            if constant.transform.proportional and not each[constant.name] > 0:
                raise FitError(f"the start of {constant.name} is {each[constant.name]:g}; it must be positive")
    ranges = [unknowns(constants, each, bounds, spacing) for each in given]
    for each in starts or ():
        for name, (low, high) in dict(bounds or {}).items():
            if name in each and not low <= each[name] <= high:
                raise FitError(f"the start of {name}, {each[name]:g}, is outside its bounds, {low:g} to {high:g}")
    both = Unknowns(constants, np.min([r.lower for r in ranges], axis=0), np.max([r.upper for r in ranges], axis=0))
    return both, [both.unknown(each) for each in given]


def _plan(unknown: Unknowns, measured: Measurement, dt: float, frame: str, compare: str) -> tuple[Plan, float]:
    """Steps so that a frame is saved at each sample: `dt` is moved to the nearest divisor of the sample spacing."""
    every = max(1, round(measured.spacing / dt))
    dt = measured.spacing / every
    early = max(0.0, -float(unknown.lower[unknown.constants.index(DELAY)])) if DELAY in unknown.constants else 0.0
    frames = max(2, int(np.ceil((measured.times[-1] + early) / measured.spacing - 1e-6)))
    solved = frame if frame == "all" else "none"  # "rest" is dealt with once, before: both share a program
    return Plan(unknown.constants, frames, every, solved, compare, measured.free_origin), dt


def _searching(evaluator: Evaluator) -> Evaluator:
    """Takes one step a sample where many are asked for."""
    return evaluator.with_steps(1) if evaluator.plan.every >= MANY_SUBSTEPS else evaluator


def _searched(evaluator: Evaluator, starts: list[np.ndarray], search: Search) -> tuple[np.ndarray, str]:
    coarse = _searching(evaluator)
    try:
        if coarse is evaluator:
            z = find(evaluator, starts, search)
        else:
            z = find(coarse, starts, dataclasses.replace(search, polish=6, tol=1e-2))
            z = _less_numerical_damping(evaluator, z)
            evaluator.stage = "polish"
            z, _ = levenberg_marquardt(evaluator, z, None, search.polish, tol=search.tol)
        polished = sum(visit.stage == "polish" for visit in evaluator.history)
        status = "converged" if polished < 2 * search.polish else "iteration limit"
    except KeyboardInterrupt:
        best = evaluator.best if evaluator.best is not None else coarse.best
        if best is None:
            raise
        return best, "interrupted"
    if not np.isfinite(evaluator.best_loss):
        raise FitError(
            "no trial gave a finite motion: check that the scene itself runs, take a smaller dt, or narrow the bounds"
        )
    return z, status


def _less_numerical_damping(evaluator: Evaluator, z: np.ndarray) -> np.ndarray:
    """What larger backward Euler steps damped, handed to the material: a mode loses omega (beta + dt) / 2 in all."""
    unknown, plan = evaluator.unknowns, evaluator.plan
    if evaluator.problem.model.scheme.order > 1:
        return z
    values = unknown.values(z)
    for each in unknown.constants:
        if each.viscous:
            values[each.name] += float(evaluator.problem.dt) * (plan.every - 1)
    return unknown.unknown(values)


def _result(
    evaluator: Evaluator,
    z: np.ndarray,
    spread: Uncertainty,
    outcome: Outcome,
    params: Params,
    measured: Measurement,
    status: str,
    warnings: tuple[str, ...],
    repairs: tuple[str, ...],
) -> FitResult:
    errors = np.abs(evaluator.unknowns.slopes(z)) * np.sqrt(np.diag(spread.covariance))
    seen = measured.seen[..., None]
    simulated, shown = (np.asarray(a, np.float64) for a in (outcome.simulated, outcome.measured))
    shown = np.where(seen, shown, np.nan)
    unit = "m" if evaluator.problem.camera is None else "px"
    count = max((3 if unit == "m" else 2) * int(measured.seen.sum()), 1)
    last = evaluator.history[-1].loss
    return FitResult(
        constants=evaluator.unknowns.constants,
        values=evaluator.unknowns.values(z),
        standard_errors=dict(zip(evaluator.unknowns.names, errors.tolist(), strict=True)),
        correlation=spread.correlation,
        params=params,
        loss=last,
        noise=float(np.sqrt(np.nansum((simulated - shown) ** 2) / count)),
        times=measured.times,
        release=measured.begins[0],
        release_interval=measured.begins[1:],
        residuals=simulated - shown,
        simulated=simulated,
        measured=shown,
        markers=evaluator.problem.markers.names,
        history=tuple(evaluator.history),
        status=status,
        warnings=warnings,
        repairs=repairs,
        unit=unit,
    )


def _cast(value: float, params: Params) -> Any:
    return np.asarray(value, params.gravity.dtype)
