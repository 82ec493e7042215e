"""What a fit found: values with intervals, how well each take is told, what to beware of."""

import dataclasses
from typing import Any

import numpy as np

from jaxfem.fitting.advice import text_of
from jaxfem.fitting.agreement import Agreement
from jaxfem.fitting.asked import Contribution, Posterior, Profile, Refinement
from jaxfem.fitting.beside import Beside
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.evaluation import Evaluator, Progress, Visit
from jaxfem.fitting.measurement import Measurement
from jaxfem.fitting.moduli import MODULI, PAIR
from jaxfem.fitting.multistart import End, in_words
from jaxfem.materials.constants import Constant
from jaxfem.model import Params, State

MUCH = 4.0
"""Standard uncertainties by which what was measured beside markers may be told otherwise."""
ASTRAY = 0.3
"""Share of the motion that may be left; beyond, the simulation does not follow the recording."""


@dataclasses.dataclass(frozen=True)
class TakeFit:
    """One recording against its simulation. `residuals` (simulated less measured, NaN where missing), `simulated`,
    `measured` (T, M, 3) in the body's frame [m, or px: `unit`]; `times` (T,) [s] since the release at `release` [s] of
    the recording, which lies in `release_interval` [s] with 95 %; `held_out`: it was not fitted, only predicted;
    `noise`: root mean square residual of a coordinate; `scatter`: what the markers scatter from sample to sample;
    `covered`: share of the samples inside their 95 % band; `autocorrelation` (K,) of the residuals, from lag 0;
    `values`: the constants' in this take; `params` and `state` (at the release) with them in; `beside`: what else was
    measured of it, against what the fit tells."""

    name: str
    held_out: bool
    markers: tuple[str, ...]
    times: np.ndarray
    release: float
    release_interval: tuple[float, float]
    residuals: np.ndarray
    simulated: np.ndarray
    measured: np.ndarray
    unit: str
    noise: float
    scatter: float
    covered: float
    autocorrelation: np.ndarray
    values: dict[str, float]
    params: Params
    state: State
    dt: float
    beside: tuple[Beside, ...] = ()

    @property
    def worst(self) -> tuple[str, str, float]:
        """Marker and axis with the largest root mean square residual, and how large it is."""
        count = np.maximum(np.isfinite(self.residuals).sum(axis=0), 1)
        rms = np.sqrt(np.nansum(self.residuals**2, axis=0) / count)
        marker, axis = np.unravel_index(int(np.argmax(rms)), rms.shape)
        return self.markers[marker], ("xyz" if self.unit == "m" else "uvw")[axis], float(rms[marker, axis])

    def line(self) -> str:
        """One line: misfit beside the markers' own scatter, the worst marker and axis."""
        marker, axis, rms = self.worst
        how = "held out" if self.held_out else "fitted"
        return (
            f"{self.name} ({how}): residual {length(self.noise, self.unit)} rms a coordinate, markers scatter by "
            f"{length(self.scatter, self.unit)}; {100 * self.covered:.0f} % of samples inside their 95 % band; worst "
            f"{marker} {axis}, {length(rms, self.unit)}; {len(self.times)} samples of {len(self.markers)} markers from "
            f"{self.release:g} s on"
        )


@dataclasses.dataclass(frozen=True)
class FitResult:
    """What a fit found.

    `constants`: those fitted, with their units; by their names (Pa, s, kg/m^3) `values`, `standard_errors`, 95 %
    `intervals`, `starts` and `bounds`; `correlation` (P, P) in the order of `values`; `params`: the first scene's with
    the values in; `loss`: mean square residual over sigma^2, or over the mean square motion where no sigma was given;
    `takes`: each recording against its simulation, those held out too; `weakest`: the combination known worst;
    `inflation`: how many neighbouring residuals tell the same; `memory`: partial autocorrelations of the noise;
    `sigmas`: standard deviation of each group's noise [m]; `history`: every evaluation; `iterations`: those with
    derivatives; `status`: "converged", "iteration limit", "steps failed" or "interrupted"; `warnings`: what may make
    values wrong; `repairs`: what was left out, repaired or noticed in the recordings; `refinements`: see
    `refine`; `agreement`: see `alone`; `ends`: where each start led, lowest loss first, if some were drawn;
    `profiles` and `contributions`: see functions `profile` and `contributions`; `posterior`: see `sample`; simulations
    were made by `engine`, for that `reason`. `times`, `release`, `residuals` and so on are those of the first take (see
    `TakeFit`).
    """

    constants: tuple[Constant, ...]
    values: dict[str, float]
    standard_errors: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    starts: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    correlation: np.ndarray
    loss: float
    takes: tuple[TakeFit, ...]
    weakest: str
    inflation: float
    memory: tuple[float, ...]
    sigmas: dict[str, float]
    history: tuple[Visit, ...]
    status: str
    warnings: tuple[str, ...]
    repairs: tuple[str, ...] = ()
    refinements: tuple[Refinement, ...] = ()
    agreement: tuple[Agreement, ...] = ()
    profiles: tuple[Profile, ...] = ()
    contributions: tuple[Contribution, ...] = ()
    ends: tuple[End, ...] = ()
    posterior: Posterior | None = None
    engine: str = ""
    reason: str = ""
    solution: Any = dataclasses.field(default=None, repr=False)

    def solved(self, progress: Progress | None = None) -> tuple[Evaluator, Any]:
        """The fit as it is evaluated, apart from the search's history, and where it ended, to go on from; FitError
        where nothing is kept. `progress` is told of each further simulation."""
        if self.solution is None:
            raise FitError("this result holds no solution to go on from: take the one that fit returned")
        evaluator, best = self.solution
        return evaluator.apart(progress), best

    @property
    def iterations(self) -> int:
        """Evaluations with derivatives."""
        return sum(visit.derivatives for visit in self.history)

    @property
    def params(self) -> Params:
        """The first take's scene with the values in."""
        return self.takes[0].params

    @property
    def times(self) -> np.ndarray:
        """Of the first take (T,) [s], since its release."""
        return self.takes[0].times

    @property
    def release(self) -> float:
        """Of the first take [s]."""
        return self.takes[0].release

    @property
    def release_interval(self) -> tuple[float, float]:
        """Of the first take [s]."""
        return self.takes[0].release_interval

    @property
    def residuals(self) -> np.ndarray:
        """Of the first take (T, M, 3)."""
        return self.takes[0].residuals

    @property
    def simulated(self) -> np.ndarray:
        """Of the first take (T, M, 3)."""
        return self.takes[0].simulated

    @property
    def measured(self) -> np.ndarray:
        """Of the first take (T, M, 3)."""
        return self.takes[0].measured

    @property
    def markers(self) -> tuple[str, ...]:
        """Of the first take."""
        return self.takes[0].markers

    @property
    def unit(self) -> str:
        """Of the first take's samples."""
        return self.takes[0].unit

    @property
    def noise(self) -> float:
        """Root mean square residual of a coordinate of the first take."""
        return self.takes[0].noise

    @property
    def fitted_constants(self) -> set[str]:
        """Names of the materials' constants that were fitted, of some body or take at least."""
        fitted = {name.split(".")[0] for name in self.values}
        return fitted | (PAIR if fitted & set(MODULI) else set())

    def _held(self) -> str:
        """Constants of materials that were not fitted, of the first take: what they are off by is in no error bar."""
        fitted, known = self.fitted_constants, self.params.constants.items()
        kept = {name: np.asarray(value, np.float64) for name, value in known if name not in fitted}
        return ", ".join(f"{name} {_range(value)}" for name, value in sorted(kept.items()) if value.size)

    def summary(self) -> str:
        """Values with error bars, the misfit and all warnings, as text."""
        lines = [text_of(self.constants, self.values, self.standard_errors, self.intervals)]
        lines += [f"  held: {held}"] if (held := self._held()) else []
        for take in self.takes:
            lines += [f"  {take.line()}", *(f"    {each.line()}" for each in take.beside)]
        lines.append(f"  {self.status}, {len(self.history)} simulations, {self.iterations} of them with derivatives")
        lines += [f'  simulated by engine "{self.engine}" ({self.reason})'] if self.engine else []
        if self.weakest:
            lines.append(f"  {self.weakest}")
        lines += [f"  {in_words(self.ends)}"] if self.ends else []
        lines += [f"  {each.line()}" for each in self.refinements]
        lines += [f"  {each.line()}" for each in self.agreement]
        lines += [f"  {each.line()}" for each in self.profiles]
        lines += [f"  {each.line()}" for each in self.contributions]
        lines += [f"  {line}" for line in self.posterior.lines()] if self.posterior else []
        lines += [f"  recording: {text}" for text in self.repairs]
        lines += [f"  warning: {text}" for text in self.warnings]
        return "\n".join(lines)


def _range(values: np.ndarray) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"


def beside_in_words(take: TakeFit) -> list[str]:
    """Warnings of what was measured beside a take's markers and is told otherwise by more than it can be off."""
    far = [each for each in take.beside if abs(each.off) > MUCH]
    if not far:
        return []
    worst = max(far, key=lambda each: abs(each.off))
    count = f" ({len(far)} such numbers)" if len(far) > 1 else ""
    return [f"{take.name}: samples and what was measured beside them do not agree{count}: {worst.line()}"]


def astray(take: TakeFit, measured: Measurement) -> list[str]:
    """A warning where the simulation does not follow the recording: what is left is a good part of the motion, and no
    scatter of samples."""
    if not measured.seen.any():
        return []
    left = float(np.sqrt(np.nanmean(np.nansum(take.residuals**2, axis=-1)[measured.seen])))
    share = left / max(measured.displacement_scale, 1e-300)
    if share < ASTRAY or take.noise < 3 * take.scatter:
        return []
    marker, axis, _ = take.worst
    return [
        f"{take.name}: the simulation does not follow the recording, {100 * share:.0f} % of the motion are left, most "
        f"at {marker} {axis}: the values say little. See the release, the end (another touch, or a second release, "
        "behind it?), the supports, the loads and the places"
    ]


def length(value: float, unit: str) -> str:
    """A length in mm, or in pixels."""
    return f"{1e3 * value:.3g} mm" if unit == "m" else f"{value:.3g} {unit}"
