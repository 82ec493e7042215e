"""Least squares again, with weights that the residuals ask for: scatter of groups, outliers, noise that remembers."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.climbing import levenberg_marquardt
from jaxfem.fitting.correlation import Channels
from jaxfem.fitting.evaluation import Evaluator
from jaxfem.fitting.noise import LOSSES, ROUNDS, Noise
from jaxfem.fitting.statistics import Uncertainty, uncertainty
from jaxfem.fitting.takes import Prepared, channels_of
from jaxfem.fitting.weighting import Arrays, Weighed, Weighting, Whitened

NEAR = 0.02  # standard errors: a round that moves less is the last
MAD = 1.4826  # standard deviations in a median absolute deviation, of a Gaussian


@dataclasses.dataclass(frozen=True)
class Judged:
    """A solution `z` (P,) and what its residuals say: `uncertainty`, `scales` (M, 3) of each take's samples, in the
    residuals' unit, `sigmas` [m] of the groups, `weighting` with which it was found."""

    z: np.ndarray
    uncertainty: Uncertainty
    scales: Arrays
    sigmas: dict[str, float]
    weighting: Weighting


def judged(
    evaluator: Evaluator, made: Sequence[Prepared], z: np.ndarray, noise: Noise, polish: int, tol: float
) -> Judged:
    """From the least-squares solution z to the one that the noise asks for, with its uncertainty.

    Weights and solution in turn (iteratively reweighted least squares, Holland & Welsch 1977; feasible generalised
    least squares, Seber & Wild 1989, section 6.2), until they agree.
    """
    found = look(evaluator, made, z, noise)
    rounds = 0 if noise.plain and evaluator.priors is None else ROUNDS
    for _ in range(rounds):
        evaluator.stage = "weights"
        evaluator.variance = 1.0  # weighted residuals are in standard deviations
        new, _ = levenberg_marquardt(evaluator, found.z, polish, found.weighting, tol=tol)
        moved = np.abs(new - found.z)
        found = look(evaluator, made, new, noise)
        bars = np.sqrt(np.maximum(np.diag(found.uncertainty.covariance), 1e-300))
        if (moved <= NEAR * bars + 1e-9).all():
            break
    return found


def look(evaluator: Evaluator, made: Sequence[Prepared], z: np.ndarray, noise: Noise) -> Judged:
    """What the residuals at z say: scatter by group, memory, uncertainty."""
    residual, jacobian, _ = evaluator.linear(z)
    given = [np.asarray(piece.problem.weights, np.float64) for piece in evaluator.pieces]
    scales = _scales(made, residual, given, noise, len(z))
    loss = LOSSES[noise.loss]
    u = [r / s for r, s in zip(residual, scales, strict=True)]
    there = [w > 0 for w in given]
    slope = np.concatenate([loss.slope(each[on]) for each, on in zip(u, there, strict=True)]).mean()
    pseudo = [loss.influence(each) / max(slope, 0.1) for each in u]
    columns = [each / s for each, s in zip(jacobian, scales, strict=True)]
    channels = [
        each
        for k, (one, w, s) in enumerate(zip(made, given, scales, strict=True))
        for each in channels_of(k, one, w / s)
    ]
    prior = None if evaluator.priors is None else evaluator.priors.precision(z)
    constants = sum(one.constants for one in made)
    spread = uncertainty(
        channels, pseudo, columns, noise.correlation, known=noise.known, constants=constants, prior=prior
    )
    weights = [np.sqrt(loss.weight(each)) / s for each, s in zip(u, scales, strict=True)]
    return Judged(z, spread, scales, _sigmas(made, given, scales, noise), _weighting(weights, channels, spread, noise))


def _weighting(weights: Arrays, channels: Sequence[Channels], spread: Uncertainty, noise: Noise) -> Weighting:
    if noise.correlation != "ar":
        return Weighed(weights)
    return Whitened(weights, channels, spread.partial)


def _scales(made: Sequence[Prepared], residual: Arrays, given: Arrays, noise: Noise, unknowns: int) -> list[np.ndarray]:
    """Standard deviation (M, 3) of each take's residuals, estimated group by group."""
    if noise.known:
        return [np.ones(r.shape[1:]) for r in residual]
    groups = [noise.group_of(one.take.name, one.markers.names) for one in made]
    pools: dict[str, list[np.ndarray]] = {}
    for r, w, words in zip(residual, given, groups, strict=True):
        for marker, word in enumerate(words):
            pools.setdefault(word, []).append(r[:, marker][w[:, marker] > 0])
    samples = sum(each.size for pool in pools.values() for each in pool)
    spread = {}
    for word, pool in pools.items():
        values = np.concatenate(pool)
        if values.size == 0:
            spread[word] = 1.0
        elif noise.loss == "square":
            spread[word] = float(np.sqrt((values**2).sum() / max(values.size * (1 - unknowns / samples), 1.0)))
        else:
            spread[word] = MAD * float(np.median(np.abs(values)))
    floor = 1e-3 * max(spread.values()) + 1e-12  # a marker that fits by chance must not rule the others
    return [np.repeat(np.array([max(spread[word], floor) for word in words])[:, None], 3, axis=1) for words in groups]


def _sigmas(made: Sequence[Prepared], given: Arrays, scales: Arrays, noise: Noise) -> dict[str, float]:
    """Standard deviation of each group's samples in their unit, root mean square over its markers."""
    squares: dict[str, list[float]] = {}
    for one, w, s in zip(made, given, scales, strict=True):
        most = w.max(axis=0)[:, : one.axes]
        for marker, word in enumerate(noise.group_of(one.take.name, one.markers.names)):
            if most[marker].all():
                squares.setdefault(word, []).extend(((s[marker, : one.axes] / most[marker]) ** 2).tolist())
    return {word: float(np.sqrt(np.mean(each))) for word, each in squares.items()}
