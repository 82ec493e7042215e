"""How much of the values is the discretisation's: the fit gone on with at half the step, and on a finer mesh.

Where errors fall as h^p, the values found with h / 2 differ from those found with h by all but 1 / 2^p of the error
(Richardson 1911), so that the error itself is about the difference times 2^p / (2^p - 1).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.asked import Refinement
from jaxfem.fitting.beside import data_of
from jaxfem.fitting.climbing import levenberg_marquardt
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Evaluator, Piece, Progress
from jaxfem.fitting.markers import Markers, attach
from jaxfem.fitting.paths import Placed, group_constants, marker_shifts, placed_constants
from jaxfem.fitting.priors import Priors
from jaxfem.fitting.result import FitResult
from jaxfem.fitting.rounds import Judged
from jaxfem.fitting.takes import Take
from jaxfem.solvers import Status
from jaxfem.stepping import typed

ITERATIONS = 8
MESH_ORDER = 2
"""Of displacements of linear elements, on meshes fine enough; coarse ones fall more slowly."""


def refine(result: FitResult, finer: Sequence[Take] = (), progress: Progress | None = None) -> FitResult:
    """The result with its `refinements`: refits from the solution at half the time step and, where takes on a `finer`
    mesh are given, by the names of those that were fitted, on that. Held are the weights of the samples. A warning
    names what the discretisation moves by more than its error bar. `progress` as in `fit_takes`. FitError for takes
    that do not match.
    """
    evaluator, best = result.solved(progress)
    first = evaluator.pieces[0].problem
    halves = [piece.with_steps(2 * piece.plan.every) for piece in evaluator.pieces]
    step = f"{1e3 * float(first.dt):.3g} to {5e2 * float(first.dt):.3g} ms"
    known = evaluator.priors
    found = [_refit(result, evaluator, best, halves, known, "time step", step, first.model.scheme.order)]
    if finer:
        by_name = {each.name: each for each in finer}
        fitted = [each.name for each in result.takes if not each.held_out]
        if missing := [name for name in fitted if name not in by_name]:
            raise FitError(f'no finer take is named "{missing[0]}": give one for each of {", ".join(fitted)}')
        pieces = [_on(piece, by_name[name]) for piece, name in zip(evaluator.pieces, fitted, strict=True)]
        known = _known_on(evaluator, pieces, [by_name[name] for name in fitted])
        counts = [each.problem.model.elements.count for each in (evaluator.pieces[0], pieces[0])]
        found.append(
            _refit(result, evaluator, best, pieces, known, "mesh", f"{counts[0]} to {counts[1]} elements", MESH_ORDER)
        )
    told = [text for each in found for text in _warnings(result, each)]
    return dataclasses.replace(result, refinements=tuple(found), warnings=(*result.warnings, *told))


def _on(piece: Piece, take: Take) -> Piece:
    """The same samples and unknowns on another take's scene."""
    params, state = typed(take.model, take.params, take.state)
    markers = take.markers if isinstance(take.markers, Markers) else attach(take.model, take.markers)
    if markers.names != piece.problem.markers.names:
        raise FitError(f'the finer take "{take.name}" has other markers: give the same ones, in the same order')
    known = {**placed_constants(take.model, params, state), **marker_shifts(markers.names, take.model)}
    known |= group_constants(take.groups or {}, take.model)
    constants = tuple(known[each.name] if isinstance(each, Placed) else each for each in piece.plan.constants)
    problem = piece.problem.replace(model=take.model, params=params, state=state, markers=markers)
    return dataclasses.replace(piece.on(problem), plan=dataclasses.replace(piece.plan, constants=constants))


def _known_on(evaluator: Evaluator, pieces: Sequence[Piece], takes: Sequence[Take]) -> Priors | None:
    """Priors, and data beside the samples told by the finer takes' scenes."""
    if evaluator.priors is None or not evaluator.priors.data:
        return evaluator.priors
    names, data = evaluator.unknowns.names, []
    for piece, take in zip(pieces, takes, strict=True):
        scene = take.model, piece.problem.params, piece.problem.state, piece.problem.markers
        own = {names[k]: each for k, each in zip(piece.columns.tolist(), piece.plan.constants, strict=True)}
        data += data_of(take.beside, scene, names, own, float(piece.problem.dt) * piece.plan.every, take.dt)
    return dataclasses.replace(evaluator.priors, data=tuple(data))


def _refit(
    result: FitResult,
    evaluator: Evaluator,
    best: Judged,
    pieces: Sequence[Piece],
    known: Priors | None,
    what: str,
    by: str,
    order: int,
) -> Refinement:
    finer = Evaluator(pieces, evaluator.unknowns, evaluator.progress, known, evaluator.variance)
    finer.stage = "refine"
    z, loss = levenberg_marquardt(finer, best.z, ITERATIONS, best.weighting, tol=1e-6)
    failed = any(int(each.status) != int(Status.CONVERGED) for each in finer.residual(z)[1]) or not np.isfinite(loss)
    values = evaluator.unknowns.values(z)
    shift = {name: values[name] - result.values[name] for name in values}
    whole = 2.0**order / (2.0**order - 1)
    return Refinement(what, by, values, shift, {name: whole * each for name, each in shift.items()}, not failed)


def _warnings(result: FitResult, each: Refinement) -> list[str]:
    if not each.converged:
        return [f"the refit with a finer {each.what} ({each.by}) had steps that failed: its values say nothing"]
    texts = []
    for name, error in each.estimate.items():
        if abs(error) > result.standard_errors[name]:
            texts.append(
                f"{name}: the {each.what} puts it off by about {error:+.2g} ({each.by}: {each.shift[name]:+.2g}), more "
                f"than its error bar of {result.standard_errors[name]:.2g}. Take the finer one"
            )
    return texts
