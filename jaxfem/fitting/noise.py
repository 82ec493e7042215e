"""What is known of the scatter of samples: its size, who shares it, whether it remembers, and how outliers count."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.errors import FitError

CORRELATIONS = ("effective", "white", "ar")
HUBER = 1.345  # 95 % efficient where noise is Gaussian after all (Huber 1981)
STUDENT = 4.0  # degrees of freedom
ROUNDS = 6


@dataclasses.dataclass(frozen=True)
class Noise:
    """The model of the samples' scatter.

    `sigma` [m, or px]: None, one number, one a marker (M,), (M, 3), or by marker's name; with `known` it is the
    standard deviation itself, else only in proportion. `groups`: whose scatter is estimated together: "all", "take",
    "marker", or words with lists of markers; then those that scatter more count less. `correlation`: "effective"
    (least squares, with error bars for noise that remembers its last samples, as far as residuals do), "white" (bars
    for independent samples) or "ar" (residuals are whitened by an autoregression, generalised least squares: the
    smallest bars where noise does remember). `loss`: "square", "huber" or "student" (outliers count less).
    """

    sigma: Any = None
    known: bool = False
    groups: Any = "all"
    correlation: str = "effective"
    loss: str = "square"

    def __post_init__(self) -> None:
        for name, value, allowed in (("correlation", self.correlation, CORRELATIONS), ("loss", self.loss, LOSSES)):
            if value not in allowed:
                raise FitError(f"{name} of the noise is {value!r}; give one of {', '.join(allowed)}")
        if isinstance(self.groups, str) and self.groups not in ("all", "take", "marker"):
            raise FitError(
                f'groups of the noise is {self.groups!r}; give "all", "take", "marker", or words with lists of markers'
            )
        if self.known and self.sigma is None:
            raise FitError("the noise is called known, and no sigma is given: give sigma, or leave known out")
        if self.known and self.groups != "all":
            raise FitError('groups are estimated, and the noise is called known: leave one out, or groups = "all"')

    @property
    def plain(self) -> bool:
        """Whether least squares will do, without a second look at the residuals."""
        return self.groups == "all" and self.loss == "square" and self.correlation != "ar"

    def scale(self, names: Sequence[str], usual: float) -> np.ndarray:
        """Scale of the residuals (M, 3): `usual` where no scatter is given, so that weights are alike."""
        sigma = self.sigma
        if isinstance(sigma, Mapping):
            missing = [name for name in names if name not in sigma]
            if missing:
                raise FitError(f'sigma names no marker "{missing[0]}"; it names {", ".join(sigma)}')
            sigma = [sigma[name] for name in names]
        count = len(names)
        array = np.asarray(usual if sigma is None else sigma, dtype=np.float64)
        array = array[:, None] if array.shape == (count,) else array
        if array.shape not in ((), (count, 1), (count, 3)) or not (np.isfinite(array).all() and (array > 0).all()):
            raise FitError(
                f"sigma is {self.sigma!r}: give the markers' scatter in m as one positive number, one for each of the "
                f"{count} markers, or ({count}, 3)"
            )
        return np.broadcast_to(array, (count, 3))

    def group_of(self, take: str, names: Sequence[str]) -> list[str]:
        """The group of each marker of a take, by its word."""
        if self.groups == "all":
            return ["all"] * len(names)
        if self.groups == "take":
            return [take] * len(names)
        if self.groups == "marker":
            return list(names)
        found = {name: word for word, markers in dict(self.groups).items() for name in markers}
        return [found.get(name, "the others") for name in names]


@dataclasses.dataclass(frozen=True)
class Loss:
    """`influence` psi(u) of a residual u in standard deviations, and its `slope`; `weight` is psi(u) / u."""

    influence: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]

    def weight(self, u: np.ndarray) -> np.ndarray:
        """psi(u) / u, 1 at 0."""
        small = np.abs(u) < 1e-12
        return np.where(small, 1.0, self.influence(u) / np.where(small, 1.0, u))


LOSSES = {
    "square": Loss(lambda u: u, lambda u: np.ones_like(u)),
    "huber": Loss(lambda u: np.clip(u, -HUBER, HUBER), lambda u: (np.abs(u) <= HUBER).astype(float)),
    "student": Loss(
        lambda u: (STUDENT + 1) * u / (STUDENT + u**2),
        lambda u: (STUDENT + 1) * (STUDENT - u**2) / (STUDENT + u**2) ** 2,
    ),
}
"""Influence functions: least squares, Huber 1964, and Student's t with four degrees of freedom (Lange et al. 1989)."""
