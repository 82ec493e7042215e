"""What is asked of a fit afterwards, as its result keeps it: finer refits, profiles, what held values add, draws."""

import dataclasses

import numpy as np

from jaxfem.fitting.advice import interval_in_words


@dataclasses.dataclass(frozen=True)
class Refinement:
    """A refit with a finer `what` ("time step" or "mesh"), `by` how much in words: its `values`, their `shift` from
    those found, and the `estimate` of what the discretisation takes off them in all; `converged`: whether its steps
    did."""

    what: str
    by: str
    values: dict[str, float]
    shift: dict[str, float]
    estimate: dict[str, float]
    converged: bool

    def line(self) -> str:
        """One line."""
        told = ", ".join(f"{name} {each:+.2g}" for name, each in self.estimate.items())
        return f"discretisation, {self.what} ({self.by}): about {told}"


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Draws from the distribution of the parameters that samples and priors leave: `values` (C, N, P) of C chains, in
    the order of `names`; `kind` of the walk; `intervals` that hold 95 % of the draws, `means` and `deviations` by name;
    `scale_reduction` (Gelman & Rubin 1992), near 1 where the chains agree, and `effective` number of independent draws
    by name; `accepted`: mean acceptance; `divergent`: how many draws the integrator lost its way in;
    `stopped`: drawing was interrupted."""

    names: tuple[str, ...]
    values: np.ndarray
    kind: str
    scale_reduction: dict[str, float]
    effective: dict[str, float]
    accepted: float
    divergent: int
    stopped: bool = False

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Between which 95 % of the draws are."""
        low, high = np.quantile(self.values.reshape(-1, len(self.names)), (0.025, 0.975), axis=0)
        return dict(zip(self.names, zip(low.tolist(), high.tolist(), strict=True), strict=True))

    @property
    def means(self) -> dict[str, float]:
        """Of all draws."""
        return dict(zip(self.names, self.values.mean(axis=(0, 1)).tolist(), strict=True))

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations of all draws."""
        return dict(zip(self.names, self.values.std(axis=(0, 1)).tolist(), strict=True))

    def lines(self) -> list[str]:
        """A line a parameter."""
        return [
            f"posterior of {name}: mean {self.means[name]:.5g} +- {self.deviations[name]:.2g} (95 %: {low:.5g} to "
            f"{high:.5g}; about {self.effective[name]:.0f} independent draws)"
            for name, (low, high) in self.intervals.items()
        ]


@dataclasses.dataclass(frozen=True)
class Profile:
    """-2 log likelihood ratio `drop` (k,) of a parameter's `values` (k,), the others at their best; `interval`: where
    it passes 3.84, infinite towards a side on which it never does before the bound: the interval is one-sided then."""

    name: str
    values: np.ndarray
    drop: np.ndarray
    interval: tuple[float, float]

    def line(self) -> str:
        """One line."""
        return f"profile of {self.name} (95 %): {interval_in_words(*self.interval)}"


@dataclasses.dataclass(frozen=True)
class Contribution:
    """How far parameters move where `what` is off by `by`, one standard uncertainty: `shift` by name, in their unit."""

    what: str
    by: str
    shift: dict[str, float]

    def line(self) -> str:
        """One line."""
        told = ", ".join(f"{name} {each:+.2g}" for name, each in self.shift.items())
        return f"Type B, {self.what} off by {self.by}: {told}"
