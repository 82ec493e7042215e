"""Whether takes agree on what they share: each alone, beside the others.

Error bars of a fit of several takes are those of their noise. Where the model is not that of the body, each take has
its own best values, and more samples make the bars shorter around none of them. Cochran's Q (1954) asks whether values
x_k with variances v_k scatter by more than that; what they scatter by beyond, tau, is the root of
sum (x_k - m)^2 / (v_k + tau^2) = K - 1 (Paule & Mandel 1982), and the interval of a mean of K such takes is Student's
(Hartung & Knapp 2001).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.evaluation import Evaluator

NEAR = 1e-3
"""Of a number of the search (its logarithm, of what is positive): takes that are no further apart are not looked at."""
ROUNDING = 1e-12
"""Of a value: standard errors are not below."""
DOUBTFUL = 0.05
"""Chance below which takes are not said to agree; no warning yet, of many parameters one may be so."""
UNLIKELY = 1e-4
"""Chance of takes' own values, below which they do not agree."""


@dataclasses.dataclass(frozen=True)
class Agreement:
    """What takes say alone of a parameter that they share: `values` and standard `errors` by take; the `chance` that
    such errors make them scatter so much (Cochran 1954); what they scatter by `between` them beyond that; their
    weighted `mean`, and the 95 % `interval` of it, which knows of both."""

    name: str
    values: dict[str, float]
    errors: dict[str, float]
    chance: float
    between: float
    mean: float
    interval: tuple[float, float]

    @property
    def agree(self) -> bool:
        """Whether noise can be all."""
        return self.chance > UNLIKELY

    def line(self) -> str:
        """One line."""
        told = ", ".join(f"{take} {value:.5g} +- {self.errors[take]:.2g}" for take, value in self.values.items())
        low, high = self.interval
        verdict = f"agree, by a chance of {self.chance:.2g}"
        if not self.agree:
            verdict = f"do not agree, and scatter by {self.between:.2g} beside their bars"
        elif self.chance < DOUBTFUL:
            verdict = f"are farther apart than their bars make them in {100 * self.chance:.1g} % of such takes"
        return f"takes alone, {self.name}: {told}; they {verdict}: mean {self.mean:.5g}, 95 % {low:.5g} to {high:.5g}"


def agreement(name: str, values: Mapping[str, float], errors: Mapping[str, float]) -> Agreement:
    """What independent `values` with standard `errors`, by take, say of one number; at least two."""
    from scipy.optimize import brentq
    from scipy.stats import chi2, norm, t

    x = np.array([*values.values()])
    least = ROUNDING * max(float(np.abs(x).max()), np.finfo(float).tiny)
    v, degrees = np.square(np.maximum([errors[take] for take in values], least)), len(x) - 1

    def excess(square: float) -> float:
        weights = 1 / (v + square)
        mean = (weights @ x) / weights.sum()
        return float(weights @ (x - mean) ** 2) - degrees

    square = 0.0
    if excess(0.0) > 0:  # nothing is left where takes scatter by all that they are apart
        square = float(brentq(excess, 0.0, 2.0 * len(x) * float(np.ptp(x)) ** 2, xtol=1e-12 * float(np.ptp(x)) ** 2))
    weights = 1 / (v + square)
    mean, error = float(weights @ x / weights.sum()), float(weights.sum() ** -0.5)
    half = float(t.ppf(0.975, degrees) if square else norm.ppf(0.975)) * error
    return Agreement(
        name=name,
        values=dict(values),
        errors={take: float(errors[take]) for take in values},
        chance=float(chi2.sf(excess(0.0) + degrees, degrees)),
        between=float(np.sqrt(square)),
        mean=mean,
        interval=(mean - half, mean + half),
    )


def first_order(evaluator: Evaluator, best: Any, residual: Any, jacobian: Any, names: Sequence[str]) -> list[str]:
    """Warnings where, to first order at the solution, takes pull what they share apart by more than noise can.

    Each take's own Gauss-Newton step from the joint solution, without a simulation: values that are far apart are
    told as such, and not exactly.
    """
    if len(names) < 2:
        return []
    flat, spread = best.weighting.residual(residual), best.uncertainty
    if not (np.isfinite(flat).all() and np.isfinite(best.weighting.columns(jacobian)).all()):
        return []  # of steps that failed: that is said
    wider = np.diag(spread.covariance) / np.maximum(np.diag(spread.plain), np.finfo(float).tiny)
    steps: dict[str, dict[str, tuple[float, float]]] = {}
    for k, (piece, take) in enumerate(zip(evaluator.pieces, names, strict=True)):
        apart = [each if at == k else np.zeros_like(each) for at, each in enumerate(jacobian)]
        columns = best.weighting.columns(apart)[piece.columns]
        inverse = np.linalg.pinv(columns @ columns.T, rcond=1e-10, hermitian=True)
        step = -inverse @ (columns @ flat)
        bars = spread.noise * np.sqrt(np.maximum(np.diag(inverse) * wider[piece.columns], 0))
        for place, moved, bar, column in zip(piece.columns, step, bars, columns, strict=True):
            if bar > 0 and column.any():
                steps.setdefault(evaluator.unknowns.names[place], {})[take] = (float(moved), float(bar))
    told = []
    for place, name in enumerate(evaluator.unknowns.names):
        own = steps.get(name, {})
        if len(own) > 1 and np.ptp([a for a, _ in own.values()]) > NEAR:
            found = agreement(name, {k: a for k, (a, _) in own.items()}, {k: b for k, (_, b) in own.items()})
            if not found.agree:
                told.append(_pulled(evaluator, best.z, place, found))
    return told


def _pulled(evaluator: Evaluator, z: np.ndarray, place: int, found: Agreement) -> str:
    low, high = evaluator.unknowns.box
    ends = {}
    for take, step in found.values.items():
        there = z.copy()
        there[place] = np.clip(z[place] + step, low[place], high[place])
        ends[take] = evaluator.unknowns.values(there)[found.name]
    apart = ", ".join(f"{take} to {value:.3g}" for take, value in ends.items())
    return (
        f"takes do not agree on {found.name}: they pull it apart, {apart} to first order, and the error bars know "
        "nothing of that. Fit each alone (jaxfem fit --alone, fitting.alone), and see loads, supports and the law"
    )
