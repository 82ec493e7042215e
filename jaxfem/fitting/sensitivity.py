"""Which take, marker, axis and part of the time tells most about which parameter, before or after measuring.

With all parameters unknown at once the information on one of them, 1 / C_pp, is a sum over samples: of (u . J_s)^2 with
u = C e_p / C_pp, C = (J'J)^-1 (Pukelsheim 2006, chapter 3). Shares of that sum are what is told here.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.before import combinations_in_words
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.recovery import assembled
from jaxfem.fitting.statistics import uncertainty
from jaxfem.fitting.takes import Take, channels_of

WINDOWS = 4
OPEN = 1e-10
"""Of what is told of a parameter alone: so much of a combination is nothing."""


@dataclasses.dataclass(frozen=True)
class Told:
    """Of one parameter: `standard_error`, as expected of independent samples, the error of places
    before the release among them; shares of the information by `takes`,
    `markers`, `axes` and `windows` of the time, each by its word, that sum to 1."""

    name: str
    unit: str
    standard_error: float
    takes: dict[str, float]
    markers: dict[str, float]
    axes: dict[str, float]
    windows: dict[str, float]

    def line(self) -> str:
        """One line: what tells most."""
        parts = []
        for what, shares in (("", self.takes), ("marker ", self.markers), ("along ", self.axes), ("", self.windows)):
            if len(shares) > 1:
                word, share = max(shares.items(), key=lambda item: item[1])
                parts.append(f"{what}{word} {100 * share:.0f} %")
        return f"  {self.name}: standard error {self.standard_error:.3g} {self.unit}".rstrip() + "; " + ", ".join(parts)


def sensitivity(
    takes: Sequence[Take],
    sigma: float,
    *,
    parameters: Sequence[str] | None = None,
    own: Sequence[str] = ("delay",),
    priors: Mapping[str, Any] | None = None,
    places: float | None = None,
) -> list[Told]:
    """What the samples of each take tell about each parameter, at the scenes' own values, where they scatter by `sigma`
    [m]. The recordings' places do not matter, only their times and gaps; `parameters`, `own`, `priors`, `places` as in
    `fit_takes`. FitError where they cannot be told apart.
    """
    noise = Noise(sigma=sigma, known=True)
    evaluator, made, shared = assembled(takes, parameters, own, None, None, noise, priors, "warn", places)
    z = shared.starts[0]
    residual, jacobian, _ = evaluator.linear(z)
    precision = sum(np.einsum("ptmi,qtmi->pq", each, each) for each in jacobian)
    if evaluator.priors is not None:
        precision = precision + evaluator.priors.precision(z)
    scale = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    sizes, shapes = np.linalg.eigh(precision / np.outer(scale, scale))
    if sizes[0] < OPEN:
        constants = evaluator.unknowns.constants
        raise FitError(combinations_in_words(constants, shapes.T[sizes < OPEN] / scale))
    covariance = np.linalg.inv(precision)
    weights = [np.asarray(piece.problem.weights, np.float64) for piece in evaluator.pieces]
    channels = [each for k, (one, w) in enumerate(zip(made, weights, strict=True)) for each in channels_of(k, one, w)]
    prior = None if evaluator.priors is None else evaluator.priors.precision(z)
    spread = uncertainty(channels, residual, jacobian, "white", known=True, prior=prior).covariance
    slopes, found = evaluator.unknowns.slopes(z), []
    for p, constant in enumerate(evaluator.unknowns.constants):
        u = covariance[p] / covariance[p, p]
        told = [np.einsum("p,ptmi->tmi", u, each) ** 2 for each in jacobian]
        bar = float(np.sqrt(spread[p, p]) * abs(slopes[p]))
        found.append(_told(constant.name, constant.unit, bar, made, told))
    return found


def _told(name: str, unit: str, bar: float, made: Sequence[Any], told: Sequence[np.ndarray]) -> Told:
    total = max(sum(float(each.sum()) for each in told), 1e-300)
    takes: dict[str, float] = {}
    markers: dict[str, float] = {}
    axes = dict.fromkeys("xyz", 0.0)
    windows: dict[str, float] = {}
    for one, each in zip(made, told, strict=True):
        takes[one.take.name] = float(each.sum()) / total
        for m, marker in enumerate(one.markers.names):
            markers[marker] = markers.get(marker, 0.0) + float(each[:, m].sum()) / total
        for k, axis in enumerate("xyz"):
            axes[axis] += float(each[..., k].sum()) / total
        times = one.measured.times
        ends = np.linspace(times[0], times[-1], WINDOWS + 1)
        for low, high in itertools.pairwise(ends):
            inside = (times >= low) & ((times < high) | (high == ends[-1]))
            word = f"{low:.3g} to {high:.3g} s"
            windows[word] = windows.get(word, 0.0) + float(each[inside].sum()) / total
    return Told(name, unit, bar, takes, markers, axes, windows)
