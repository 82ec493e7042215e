"""From a solution to what users see of it: intervals, each take's misfit, warnings; takes held out, predicted."""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.advice import advice, sample_advice, smooth, weakest_in_words
from jaxfem.fitting.agreement import first_order
from jaxfem.fitting.before import falling, is_held, sets_in_motion
from jaxfem.fitting.beside import Beside
from jaxfem.fitting.climbing import levenberg_marquardt
from jaxfem.fitting.coarseness import coarse_warnings
from jaxfem.fitting.evaluation import Evaluator, Piece
from jaxfem.fitting.markers import marker_places
from jaxfem.fitting.multistart import doubts, waterfall
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.objective import Outcome
from jaxfem.fitting.paths import with_all
from jaxfem.fitting.place_checks import most_turned
from jaxfem.fitting.release import scatter
from jaxfem.fitting.result import FitResult, TakeFit, astray, beside_in_words
from jaxfem.fitting.rounds import Judged
from jaxfem.fitting.sharing import Shared, all_shifts, shared_unknowns
from jaxfem.fitting.statistics import autocorrelation
from jaxfem.fitting.suspects import told_suspects, unfollowed
from jaxfem.fitting.swings import swing_warnings
from jaxfem.fitting.takes import Prepared, compiled_piece, data_beside
from jaxfem.fitting.unknowns import DELAY, Unknowns
from jaxfem.materials.constants import Constant

LAGS = 60
BAND = 1.959963984540054  # 95 % of a Gaussian


def result_of(
    evaluator: Evaluator,
    made: Sequence[Prepared],
    shared: Shared,
    best: Judged,
    noise: Noise,
    held: Sequence[TakeFit],
    status: str,
    faults: Sequence[str],
    repairs: Sequence[str],
    ends: Sequence[tuple[np.ndarray, np.ndarray, float]] = (),
) -> FitResult:
    """The result at the solution; `ends`: (start, end, loss) of each start, where some were drawn."""
    z, spread, unknown = best.z, best.uncertainty, evaluator.unknowns
    residual, jacobian, outcomes = evaluator.linear(z)
    failed = any(int(each.status) != 0 for each in outcomes)
    sigma = [
        _sigma_of(piece, scales, spread.noise) for piece, scales in zip(evaluator.pieces, best.scales, strict=True)
    ]
    takes = [
        take_of(each, piece, outcome, own, unknown.values(z), width, told_beside(each, unknown, own, z))
        for each, piece, outcome, own, width in zip(made, evaluator.pieces, outcomes, shared.own, sigma, strict=True)
    ]
    bars = np.sqrt(np.maximum(np.diag(spread.covariance), 0.0))
    first, piece = made[0], evaluator.pieces[0]
    fall = waterfall(unknown, ends, evaluator.samples, spread.inflation) if ends else ()
    failures = evaluator.step_failures if failed else 0
    dt = float(piece.problem.dt)
    turns = [most_turned(one.measured.stood, marker_places(one.markers, one.state), one.take.frame) for one in made]
    warnings = [
        *doubts(fall),
        *advice(
            first.take.model, takes[0].params, unknown, z, spread, first.measured, takes[0].simulated, dt, failures
        ),
        *sample_advice([each.measured for each in made], unknown, spread, [each.take.name for each in made]),
        *(text for one in made for text in one.doubts),
        *(paces := _paces(made, takes, unknown)),
        *_coarse(made, takes, unknown, bars),
        *(doubted := unfollowed(spread, takes)),
        *(told_suspects(takes, evaluator, jacobian, turns) if not paces and (doubted or smooth(spread)) else []),
        *(text for each in takes for text in beside_in_words(each)),
        *(text for each, one in zip(takes, made, strict=True) for text in astray(each, one.measured)),
        *first_order(evaluator, best, residual, jacobian, [each.take.name for each in made]),
    ]
    return FitResult(
        constants=unknown.constants,
        values=unknown.values(z),
        standard_errors=dict(zip(unknown.names, (np.abs(unknown.slopes(z)) * bars).tolist(), strict=True)),
        intervals=intervals(evaluator, z, spread.factor * bars),
        starts=shared.first,
        bounds=dict(zip(unknown.names, zip(unknown.lower.tolist(), unknown.upper.tolist(), strict=True), strict=True)),
        correlation=spread.correlation,
        loss=evaluator.loss(residual),
        takes=(*takes, *held),
        weakest=weakest_in_words(unknown, z, spread),
        inflation=spread.inflation,
        memory=spread.partial,
        sigmas={word: float(value * (1 if noise.known else spread.noise)) for word, value in best.sigmas.items()},
        history=tuple(evaluator.history),
        status="steps failed" if status == "converged" and failed else status,
        warnings=(*faults, *warnings),
        repairs=tuple(repairs),
        ends=fall,
        solution=(evaluator.apart(), best),  # without the caller's `progress`, and what it holds
    )


def _paces(made: Sequence[Prepared], takes: Sequence[TakeFit], unknown: Unknowns) -> list[str]:
    """Warnings of takes that sink too far, or too little, for how they ring."""
    texts, late = [], sets_in_motion(unknown.names)
    for one, take in zip(made, takes, strict=True):
        model = one.take.model
        if (
            is_held(model)
            and len(model.bodies) == 1
            and one.take.compare == "displacement"
            and falling(model, one.params, one.state, late)
        ):
            texts += swing_warnings(take, model.scheme.order)
    return texts


def _coarse(made: Sequence[Prepared], takes: Sequence[TakeFit], unknown: Unknowns, bars: np.ndarray) -> list[str]:
    """Warnings of meshes that put a stiffness off that was fitted, each of them once."""
    axis = unknown.scanned
    if axis is None:
        return []
    different = {id(one.take.model): (one, take) for one, take in zip(reversed(made), reversed(takes), strict=True)}
    return [
        text
        for one, take in reversed(different.values())
        if is_held(one.take.model)
        for text in coarse_warnings(take.name, one.take.model, take.params, float(bars[axis]))
    ]


def intervals(evaluator: Evaluator, z: np.ndarray, half: np.ndarray) -> dict[str, tuple[float, float]]:
    """95 % intervals of the values: those of z, through the transforms, so that positive values have positive ends.
    They end at the bounds at the latest: beyond, nothing was looked at."""
    unknown, found = evaluator.unknowns, {}
    lowest, highest = unknown.box
    low, high = unknown.values(np.maximum(z - half, lowest)), unknown.values(np.minimum(z + half, highest))
    for name in unknown.names:
        found[name] = (min(low[name], high[name]), max(low[name], high[name]))
    return found


def take_of(
    made: Prepared,
    piece: Piece,
    outcome: Outcome,
    own: Mapping[str, Constant],
    values: Mapping[str, float],
    sigma: np.ndarray,
    beside: Sequence[Beside] = (),
    held_out: bool = False,
) -> TakeFit:
    """A take against its simulation; `sigma`, (M, 3) or (T, M, 3), of its samples; `beside`: what else was measured."""
    measured, seen = made.measured, made.measured.seen[..., None]
    simulated, shown = (np.asarray(a, np.float64) for a in (outcome.simulated, outcome.measured))
    shown = np.where(seen, shown, np.nan)
    residuals = simulated - shown
    count = max(made.axes * int(measured.seen.sum()), 1)
    inside = np.abs(residuals[..., : made.axes]) <= BAND * np.broadcast_to(sigma, residuals.shape)[..., : made.axes]
    found = {constant.name: values[name] for name, constant in own.items()}
    dtype = piece.problem.model.rest.dtype
    cast = {name: jnp.asarray(value, dtype) for name, value in found.items() if name != DELAY.name}
    params, state = with_all(made.params, made.state, cast, piece.plan.constants)
    return TakeFit(
        name=made.take.name,
        held_out=held_out,
        markers=made.markers.names,
        times=measured.times,
        release=measured.begins[0],
        release_interval=measured.begins[1:],
        residuals=residuals,
        simulated=simulated,
        measured=shown,
        unit=made.unit,
        noise=float(np.sqrt(np.nansum(residuals**2) / count)),
        scatter=sample_scatter(shown[..., : made.axes]),
        covered=float(inside[np.isfinite(residuals[..., : made.axes])].mean()) if measured.seen.any() else 0.0,
        autocorrelation=autocorrelation(np.nan_to_num(residuals), measured.seen, LAGS),
        values=found,
        params=params,
        state=state,
        dt=float(piece.problem.dt),
        beside=tuple(beside),
    )


def told_beside(made: Prepared, unknowns: Unknowns, own: Mapping[str, Constant], z: np.ndarray) -> list[Beside]:
    """What was measured beside the markers of a take, against what z tells."""
    return [each for one in data_beside(made, unknowns, own) for each in one.told(z)]


def sample_scatter(places: np.ndarray) -> float:
    """What markers scatter from one sample to the next: root mean square over (T, M, axes), as of white noise."""
    lines = [each[np.isfinite(each)] for each in places.reshape(len(places), -1).T]
    found = [scatter(line) for line in lines if line.size]
    return float(np.sqrt(np.mean(np.square(found)))) if found else 0.0


def held_take(
    made: Prepared,
    shared: Shared,
    best: Judged,
    noise: Noise,
    usual: Mapping[str, float],
    parameters: Sequence[str] | None,
    own: Sequence[str],
) -> TakeFit:
    """A take that was not fitted, as the found values predict it; what it has for itself is fitted to it alone."""
    shifts = [name for name in all_shifts([made]) if name in shared.unknowns.names]
    there = shared_unknowns([made], parameters, own, None, None, shifts)
    values = shared.unknowns.values(best.z)
    known = {name: values[name] for name in there.unknowns.names if name in values and name not in own}
    piece = compiled_piece(made, there.unknowns, there.own[0], noise, usual[made.unit] if usual[made.unit] else 1.0)
    alone = Evaluator([piece], there.unknowns)
    z = there.unknowns.unknown({**there.first, **known})
    z[[name in known for name in there.unknowns.names]] = [
        each.transform.unknown(known[each.name]) for each in there.unknowns.constants if each.name in known
    ]
    free = np.array([name not in known for name in there.unknowns.names])
    if free.any():
        z, _ = levenberg_marquardt(alone, z, 20, chosen=free, tol=1e-6)
    _, jacobian, outcomes = alone.linear(z)
    weights = np.asarray(piece.problem.weights, np.float64)
    columns = jacobian[0] / np.where(weights > 0, weights, 1.0)
    places = [shared.unknowns.names.index(name) for name in there.unknowns.names if name in known]
    part = columns[[name in known for name in there.unknowns.names]]
    covariance = best.uncertainty.covariance[np.ix_(places, places)]
    told = np.einsum("ptmi,pq,qtmi->tmi", part, covariance, part)
    group = noise.group_of(made.take.name, made.markers.names)
    usual_sigma = float(np.sqrt(np.mean(np.square(list(best.sigmas.values())))))
    by_marker = np.array([best.sigmas.get(word, usual_sigma) for word in group])[:, None]
    by_marker = by_marker * (1.0 if noise.known else best.uncertainty.noise)
    return take_of(
        made,
        piece,
        outcomes[0],
        there.own[0],
        there.unknowns.values(z),
        np.sqrt(told + by_marker**2),
        told_beside(made, there.unknowns, there.own[0], z),
        held_out=True,
    )


def _sigma_of(piece: Piece, scales: np.ndarray, noise: float) -> np.ndarray:
    """Standard deviation (M, 3) of a take's samples in their unit."""
    most = np.asarray(piece.problem.weights, np.float64).max(axis=0)
    return np.asarray(noise * scales / np.where(most > 0, most, 1.0))
