"""Noise that remembers: its autocorrelation, from residuals, by an autoregression.

Residuals of a fit remember less than the noise did, since the fit took part of it; restricted likelihood (Patterson &
Thompson 1971) knows that. Order by the Bayesian information criterion (Schwarz 1978).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

MOST_ORDER = 3
LONGEST = 0.995  # partial autocorrelation that still can be told from a drift
ROWS = 400  # longer takes are looked at in pieces that count as independent
MOST_COLUMNS = 24  # with more unknowns their share of the residuals is left out


@dataclasses.dataclass(frozen=True)
class Channels:
    """Samples of markers of one take that were seen in the same rows: `rows` (k,) of them in the take, `marks` (m,);
    `when` (n + k,): numbers of the rows, the still ones before the release first; `still` (n, m, 3) residuals there;
    `offset`: whether each channel has a level of its own that is not known; `pinned`: whether the median of the still
    rows was taken for it; `take`: number of the take; `axes` of a sample."""

    take: int
    rows: np.ndarray
    marks: np.ndarray
    when: np.ndarray
    still: np.ndarray
    offset: bool
    pinned: bool
    axes: int = 3

    def extended(self, values: np.ndarray, with_still: bool) -> np.ndarray:
        """Columns (n + k, m * axes, ...) of values (T, M, 3), or of several, (P, T, M, 3); still rows in front."""
        taken = np.moveaxis(np.asarray(values)[..., self.rows, :, :][..., self.marks, : self.axes], -3, 0)
        flat = np.moveaxis(taken, -3, -1) if values.ndim == 4 else taken[..., None]  # (k, m, axes, P)
        still = np.zeros((len(self.still), *flat.shape[1:]))
        if with_still:
            still[..., 0] = self.still[:, :, : self.axes]
        joined = np.concatenate([still, flat])
        return joined.reshape(len(joined), -1, joined.shape[-1])


def autocorrelations(partial: Sequence[float], count: int) -> np.ndarray:
    """Autocorrelations (count,) of the autoregression with these partial ones (Durbin 1960, Levinson 1947)."""
    rho, phi = np.zeros(max(count, len(partial) + 1)), np.zeros(0)
    rho[0] = 1.0
    for k, kappa in enumerate(partial):
        rho[k + 1] = kappa * (1 - phi @ rho[1 : k + 1]) + phi @ rho[k:0:-1] if k else kappa
        phi = np.append(phi - kappa * phi[::-1], kappa)
    for k in range(len(partial) + 1, count):
        rho[k] = phi @ rho[k - 1 : k - 1 - len(phi) : -1]
    found: np.ndarray = rho[:count]
    return found


def correlation_matrix(partial: Sequence[float], when: np.ndarray) -> np.ndarray:
    """Correlations between rows of the numbers `when`."""
    lags = np.abs(when[:, None] - when)
    return np.asarray(autocorrelations(partial, int(lags.max(initial=0)) + 1)[lags])


def whitened(partial: Sequence[float], when: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, float]:
    """Columns (k, ...) times the inverse Cholesky factor of their rows' correlation, and the log of its determinant."""
    from scipy.linalg import solve_triangular

    if not len(partial):
        return columns, 0.0
    parts, logs = [], 0.0
    for begin in range(0, len(when), ROWS):
        part = slice(begin, begin + ROWS)
        factor = np.linalg.cholesky(correlation_matrix(partial, when[part]) + 1e-12 * np.eye(len(when[part])))
        flat = columns[part].reshape(len(when[part]), -1)
        parts.append(solve_triangular(factor, flat, lower=True, check_finite=False).reshape(columns[part].shape))
        logs += 2 * float(np.log(np.diag(factor)).sum())
    return np.concatenate(parts), logs


def estimated(blocks: Sequence[tuple[Channels, np.ndarray, np.ndarray]], most: int = MOST_ORDER) -> tuple[float, ...]:
    """Partial autocorrelations of the noise in residuals; () where it remembers nothing.

    `blocks`: channels with their residuals (k, c, 1) and Jacobian columns (k, c, P), still rows among them.
    """
    from scipy.optimize import minimize, minimize_scalar

    count = sum(r.shape[0] * r.shape[1] for _, r, _ in blocks)
    best: tuple[float, ...] = ()
    lowest = misfit(blocks, ())
    if not np.isfinite(lowest):
        return ()
    for order in range(1, most + 1):
        if order == 1:
            top = np.arctanh(LONGEST)
            found = minimize_scalar(
                lambda u: misfit(blocks, (np.tanh(u),)), bounds=(-top, top), method="bounded", options={"xatol": 1e-3}
            )
            at: tuple[float, ...] = (float(np.tanh(found.x)),)
        else:
            start = np.arctanh(np.append(np.clip(best, -LONGEST, LONGEST), 0.0))
            found = minimize(
                lambda u: misfit(blocks, tuple(LONGEST * np.tanh(u))),
                start,
                method="Nelder-Mead",
                options={"xatol": 3e-3, "fatol": 1e-2, "maxfev": 30 * order},
            )
            at = tuple(float(each) for each in LONGEST * np.tanh(found.x))
        criterion = found.fun + order * np.log(count)
        if criterion >= lowest:
            break
        best, lowest = at, criterion
    return best


def misfit(blocks: Sequence[tuple[Channels, np.ndarray, np.ndarray]], partial: Sequence[float]) -> float:
    """-2 log of the restricted likelihood, less a constant; the noise's variance and the levels are found with it."""
    size = blocks[0][2].shape[-1]
    normal, right, square, logs, freedom = np.zeros((size, size)), np.zeros(size), 0.0, 0.0, -size
    for channels, residual, columns in blocks:
        both, determinant, levels = levelled(partial, channels, np.concatenate([residual, columns], axis=-1))
        logs += residual.shape[1] * determinant
        freedom += residual.shape[0] * residual.shape[1] - levels
        flat = both.reshape(-1, 1 + size)
        product = flat.T @ flat
        square += product[0, 0]
        right += product[1:, 0]
        normal += product[1:, 1:]
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal / np.outer(scale, scale) + 1e-10 * np.eye(size)
    left = square - right / scale @ np.linalg.solve(scaled, right / scale) if size else square
    if left <= 0 or freedom <= 0:
        return np.inf
    return float(freedom * np.log(left) + logs + np.linalg.slogdet(scaled)[1] + 2 * np.log(scale).sum())


def levelled(partial: Sequence[float], channels: Channels, columns: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Whitened columns (k, c, ...), without the level of each channel where it has one of its own; the log of the
    determinant of a channel, levels among it; the number of levels."""
    rows, count = columns.shape[:2]
    flat = np.concatenate([columns.reshape(rows, -1), np.ones((rows, 1))], axis=1)
    white, log = whitened(partial, channels.when, flat)
    one, white = white[:, -1], white[:, :-1]
    if not channels.offset:
        return white.reshape(columns.shape), log, 0
    known = float(one @ one)
    white = white - np.outer(one, one @ white / known)
    return white.reshape(columns.shape), log + float(np.log(known)), count


def integrated(partial: Sequence[float]) -> float:
    """1 + 2 sum of the autocorrelations: how many neighbouring samples tell the same."""
    if not len(partial):
        return 1.0
    phi = np.zeros(0)
    for kappa in partial:
        phi = np.append(phi - kappa * phi[::-1], kappa)
    innovations = np.prod([1 - kappa**2 for kappa in partial])
    return max(1.0, float(innovations / (1 - phi.sum()) ** 2))
