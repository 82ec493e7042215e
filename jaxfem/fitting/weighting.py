"""Linear maps of residuals before their squares are summed: none, averages over time, weights and whitening.

Each takes residuals (T, M, 3) and Jacobians (P, T, M, 3) of all takes to one vector (N,) and its columns (P, N).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.correlation import Channels, levelled
from jaxfem.pytrees import Pytree
from jaxfem.tensors import contract

Arrays = Sequence[np.ndarray]


class Weighting(Protocol):
    """What a search asks of such a map."""

    def residual(self, r: Arrays) -> np.ndarray:
        """The vector (N,) of residuals of all takes."""

    def columns(self, jacobian: Arrays) -> np.ndarray:
        """Its derivatives (P, N)."""

    def maps(self, count: int) -> "tuple[SquareOf, ...]":
        """The sum of its squares, take by take, as functions that JAX can trace; of `count` takes."""


class SquareOf(Pytree):
    """The part of the squares that one take has: residuals (T, M, 3) times `weights`, then of each of the `blocks` the
    square of `matrix` (N, k) times the rows `rows` (k,) and markers `marks` (m,) more the `still` ones (N, m, axes)."""

    weights: Any
    blocks: tuple[dict[str, Any], ...] = ()

    def square(self, r: Any) -> Any:
        """The sum of squares."""
        weighed = r * self.weights
        if not self.blocks:
            return jnp.sum(weighed**2)
        total = jnp.zeros((), weighed.dtype)
        for each in self.blocks:
            still = each["still"]
            taken = weighed[each["rows"].astype(int)][:, each["marks"].astype(int), : still.shape[-1]]
            total = total + jnp.sum((contract("nk,kma->nma", each["matrix"], taken) + still) ** 2)
        return total


class Plain:
    """As they are."""

    def residual(self, r: Arrays) -> np.ndarray:
        """All residuals in a row."""
        return np.concatenate([each.ravel() for each in r])

    def columns(self, jacobian: Arrays) -> np.ndarray:
        """Their derivatives."""
        return np.concatenate([each.reshape(len(each), -1) for each in jacobian], axis=1)

    def maps(self, count: int) -> tuple[SquareOf, ...]:
        """Their squares."""
        return (SquareOf(np.ones(())),) * count


class Smoothed:
    """Averaged over time by a function (..., T, M, 3) -> (..., T, M, 3) for each take."""

    def __init__(self, smoothers: Sequence[Callable[[np.ndarray], np.ndarray]]):
        self.smoothers = smoothers

    def residual(self, r: Arrays) -> np.ndarray:
        """All averages in a row."""
        return Plain().residual([smooth(each) for smooth, each in zip(self.smoothers, r, strict=True)])

    def maps(self, count: int) -> tuple[SquareOf, ...]:
        """Averages are a means of the search: nothing is drawn from them."""
        raise NotImplementedError("smoothed residuals have no likelihood")

    def columns(self, jacobian: Arrays) -> np.ndarray:
        """Their derivatives."""
        return Plain().columns([smooth(each) for smooth, each in zip(self.smoothers, jacobian, strict=True)])


@dataclasses.dataclass(frozen=True)
class Weighed:
    """Each sample times its weight: `weights` (T, M, 3) of each take."""

    weights: Arrays

    def residual(self, r: Arrays) -> np.ndarray:
        """All weighed residuals in a row."""
        return Plain().residual(self.arrays(r))

    def columns(self, jacobian: Arrays) -> np.ndarray:
        """Their derivatives."""
        return Plain().columns(self.arrays(jacobian))

    def maps(self, count: int) -> tuple[SquareOf, ...]:
        """Their squares."""
        return tuple(SquareOf(weight) for weight in self.weights)

    def arrays(self, values: Arrays) -> list[np.ndarray]:
        """Residuals or Jacobians, weighed."""
        return [weight * each for weight, each in zip(self.weights, values, strict=True)]


@dataclasses.dataclass(frozen=True)
class Whitened:
    """Weighed, then freed of what noise with partial autocorrelations `partial` remembers, and of the level of each of
    the `channels`, for which still samples count as much as others do."""

    weights: Arrays
    channels: Sequence[Channels]
    partial: tuple[float, ...]

    def residual(self, r: Arrays) -> np.ndarray:
        """All whitened residuals in a row."""
        weighed = Weighed(self.weights).arrays(r)
        parts = [each.extended(weighed[each.take], True) for each in self.channels]
        return np.concatenate(
            [self._white(each, part).ravel() for each, part in zip(self.channels, parts, strict=True)]
        )

    def columns(self, jacobian: Arrays) -> np.ndarray:
        """Their derivatives."""
        weighed = Weighed(self.weights).arrays(jacobian)
        parts = [each.extended(weighed[each.take], False) for each in self.channels]
        white = [self._white(each, part) for each, part in zip(self.channels, parts, strict=True)]
        return np.concatenate([each.reshape(-1, each.shape[-1]).T for each in white], axis=1)

    def maps(self, count: int) -> tuple[SquareOf, ...]:
        """Their squares: whitening as a matrix on each channel's rows, what still ones add as a constant."""
        blocks: list[list[dict[str, Any]]] = [[] for _ in range(count)]
        for each in self.channels:
            first, rows = len(each.still), len(each.still) + len(each.rows)
            matrix = levelled(self.partial, each, np.eye(rows)[:, None])[0][:, 0]
            still = each.still[:, :, : each.axes]
            own = {
                "rows": np.asarray(each.rows, np.float64),
                "marks": np.asarray(each.marks, np.float64),
                "matrix": matrix[:, first:],
                "still": np.einsum("nk,kma->nma", matrix[:, :first], still),
            }
            blocks[each.take].append(own)
        return tuple(SquareOf(weight, tuple(own)) for weight, own in zip(self.weights, blocks, strict=True))

    def _white(self, channels: Channels, columns: np.ndarray) -> np.ndarray:
        return levelled(self.partial, channels, columns)[0]


def smoother(times: np.ndarray, seen: np.ndarray, width: float) -> Callable[[np.ndarray], np.ndarray]:
    """Averages arrays (..., T, M, 3) over time with a Gaussian of standard deviation `width`; missing samples are left
    out."""
    kernel = np.exp(-0.5 * ((times[:, None] - times) / width) ** 2)
    share = kernel[:, :, None] * seen  # (T, T, M)
    share = share / np.maximum(share.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    share = np.moveaxis(share * seen[:, None], 2, 0)  # (M, T, T)
    return lambda a: np.moveaxis(share @ np.moveaxis(a, -2, -3), -3, -2)
