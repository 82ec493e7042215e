"""What is known of parameters beside the samples, before or by other data: rows of their own.

A Gaussian on the value, or on its logarithm where it is known to a factor (Tarantola 2005, chapter 1).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.unknowns import Unknowns


@dataclasses.dataclass(frozen=True)
class Gaussian:
    """A value known to be `mean`, with the standard deviation `deviation`, both in its unit."""

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mean) and np.isfinite(self.deviation) and self.deviation > 0):
            raise FitError(f"a prior has mean {self.mean} and deviation {self.deviation}: give deviation > 0")

    def score(self, value: Any) -> Any:
        """(value - mean) / deviation; traceable."""
        return (value - self.mean) / self.deviation

    def row(self, value: float) -> tuple[float, float]:
        """The score, and its derivative in the value."""
        return float(self.score(value)), 1 / self.deviation


@dataclasses.dataclass(frozen=True)
class LogNormal:
    """A positive value known to be `median` to a `factor`: within it two times in three."""

    median: float
    factor: float

    def __post_init__(self) -> None:
        if not (self.median > 0 and np.isfinite(self.median) and self.factor > 1 and np.isfinite(self.factor)):
            raise FitError(f"a prior has median {self.median} and factor {self.factor}: give median > 0 and factor > 1")

    def score(self, value: Any) -> Any:
        """log(value / median) / log factor; traceable."""
        return jnp.log(value / self.median) / float(np.log(self.factor))

    def row(self, value: float) -> tuple[float, float]:
        """The score, and its derivative in the value."""
        width = float(np.log(self.factor))
        return float(np.log(value / self.median)) / width, 1 / (width * value)


class Rows(Protocol):
    """Data that stand beside samples as rows of their own."""

    def rows(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k,) in standard uncertainties, and derivatives (k, P) in z."""


@dataclasses.dataclass(frozen=True)
class Priors:
    """What is known of unknowns beside samples: priors by their names, and `data`."""

    unknowns: Unknowns
    known: Mapping[str, Any]
    data: tuple[Any, ...] = ()

    def rows(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k,) in standard deviations, and derivatives (k, P) in z."""
        values, slopes = self.unknowns.values(z), self.unknowns.slopes(z)
        rows, jacobian = np.zeros(len(self.known)), np.zeros((len(self.known), z.size))
        for k, (name, prior) in enumerate(self.known.items()):
            place = self.unknowns.names.index(name)
            rows[k], slope = prior.row(values[name])
            jacobian[k, place] = slope * slopes[place]
        parts: list[tuple[np.ndarray, np.ndarray]] = [(rows, jacobian), *(each.rows(z) for each in self.data)]
        return np.concatenate([row for row, _ in parts]), np.concatenate([own for _, own in parts])

    def precision(self, z: np.ndarray) -> np.ndarray:
        """J'J (P, P) of the rows."""
        jacobian = self.rows(z)[1]
        return np.asarray(jacobian.T @ jacobian)


def checked_priors(unknowns: Unknowns, priors: Mapping[str, Any] | None, data: Sequence[Rows] = ()) -> Priors | None:
    """Priors of the fitted parameters and data beside the samples, None without either; FitError for one that is not
    fitted or no prior."""
    if not priors and not data:
        return None
    for name, prior in (priors or {}).items():
        if name not in unknowns.names:
            raise FitError(f'a prior is given for "{name}", which is not fitted; fitted: {", ".join(unknowns.names)}')
        if not hasattr(prior, "row"):
            raise FitError(
                f"the prior of {name} is {prior!r}: give a Gaussian(mean, deviation) or LogNormal(median, factor)"
            )
        low = unknowns.constants[unknowns.names.index(name)].transform.low
        if isinstance(prior, LogNormal) and low < 0:
            raise FitError(f"the prior of {name} is of its logarithm, but it may be negative: give a Gaussian")
    return Priors(unknowns, dict(priors or {}), tuple(data))
