"""What the residuals at the end of a fit say: scatter, error bars, correlations."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.correlation import MOST_COLUMNS, Channels, correlation_matrix, estimated, integrated, levelled

OPEN_CORRELATION = 0.995
Blocks = Sequence[tuple[Channels, np.ndarray, np.ndarray]]


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """`covariance` (P, P) of the free numbers z, `noise` (the residuals' scatter, in units of sigma), `inflation`: how
    many neighbouring samples tell the same, `singular`: whether some combination of the unknowns is not seen at all;
    `partial`: partial autocorrelations of the noise; `freedom`: degrees of freedom of the scatter, as of independent
    samples; `weakest` (P,): the combination of z that is known worst, in standard deviations of each; `plain`
    (P, P): the covariance of independent samples, with so many `degrees` of freedom."""

    covariance: np.ndarray
    noise: float
    inflation: float
    singular: bool
    partial: tuple[float, ...] = ()
    freedom: float = np.inf
    weakest: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    plain: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    degrees: float = np.inf

    @property
    def correlation(self) -> np.ndarray:
        """Correlation (P, P)."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))  # rounding of what samples leave open
        return np.asarray(self.covariance / np.maximum(np.outer(spread, spread), np.finfo(float).tiny))

    def drop(self, now: float, least: float, place: int, known: float = 0.0) -> float:
        """-2 log likelihood ratio of misfits, sums of squares, where one parameter is off its best value; `known`: what
        the squares of the priors' rows grow by.

        Scaled so that its curvature is that of the error bar, which knows of noise that remembers (Chandler & Bate
        2007).
        """
        ratio = self.plain[place, place] / self.covariance[place, place]
        if not np.isfinite(self.degrees):
            return float(ratio * (now - least + known))
        return float(ratio * (self.degrees * np.log(now / least) + known))

    @property
    def factor(self) -> float:
        """Half a 95 % interval in standard errors: Student's t."""
        from scipy.stats import t

        return float(t.ppf(0.975, max(self.freedom, 1.0)))


def uncertainty(
    channels: Sequence[Channels],
    residual: Sequence[np.ndarray],
    jacobian: Sequence[np.ndarray],
    correlation: str,
    *,
    known: bool = False,
    constants: int = 0,
    prior: np.ndarray | None = None,
    partial: tuple[float, ...] | None = None,
) -> Uncertainty:
    """Error bars from residuals (T, M, 3) and Jacobians (P, T, M, 3) of each take.

    Least squares about the solution with noise of covariance s^2 V: "white" V = 1; "effective" cov = s^2 (J'J)^-1 J'VJ
    (J'J)^-1, V an autoregression that the residuals show (a body that rings hears noise of its own pitch, so that a
    single number of effective samples would not do); "ar", where the fit was made with V, cov = s^2 (J'V^-1 J)^-1.
    Displacements from a place that is itself the median of still samples share its error. `known`: s = 1. `constants`:
    further unknowns (a frame) that were found along the way. `prior` (P, P): precision of what was known of z before, s
    included. Seber & Wild 1989, chapters 5 and 6.
    """
    blocks = [
        (each, each.extended(residual[each.take], True), each.extended(jacobian[each.take], False)) for each in channels
    ]
    size = len(jacobian[0])
    if partial is None:
        slim = blocks if size <= MOST_COLUMNS else [(each, r, j[..., :0]) for each, r, j in blocks]
        partial = () if correlation == "white" else estimated(slim)
    normal, middle, squares, freedom = np.zeros((size, size)), np.zeros((size, size)), 0.0, 0.0 - size - constants
    for each, r, j in blocks:
        if correlation == "ar":
            white, _, levels = levelled(partial, each, np.concatenate([r, j], axis=-1))
            flat = white[..., 1:].reshape(-1, size)
            normal += flat.T @ flat
            middle += flat.T @ flat
            squares += float((white[..., 0] ** 2).sum())
            freedom += white[..., 0].size - levels
        else:
            levels = levelled((), each, r)[2]
            own, between = _sandwich(each, j, partial)
            normal += own
            middle += between
            squares += float((levelled(partial, each, r)[0] ** 2).sum())
            freedom += r.size - levels
    variance = 1.0 if known else squares / max(freedom, 1.0)
    precision = normal / variance + (0.0 if prior is None else prior)
    inverse, singular, weakest = _inverted(precision)
    between = middle / variance + (0.0 if prior is None else prior)
    inflation = integrated(partial)
    with np.errstate(invalid="ignore", over="ignore"):
        covariance = inverse @ between @ inverse
    return Uncertainty(
        covariance,
        float(np.sqrt(variance)),
        inflation,
        singular,
        partial,
        np.inf if known else max(freedom / (1.0 if correlation == "ar" else inflation), 1.0),
        weakest,
        inverse,
        np.inf if known else max(freedom, 1.0),
    )


def _sandwich(channels: Channels, columns: np.ndarray, partial: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """J'J and J'VJ (P, P) of least squares of columns (n + k, c, P), the error of the origin among V."""
    still = len(channels.still)
    j = columns[still:]
    normal = np.einsum("kcp,kcq->pq", j, j)
    v = correlation_matrix(partial, channels.when)
    own = v[still:, still:]
    rows = channels.when <= 0
    if channels.pinned and rows.any():
        # the median of n correlated normal numbers: its variance, and its covariance with each of them (Bahadur 1966)
        shared = v[rows, still:].mean(axis=0)
        own = own + np.arcsin(np.clip(v[np.ix_(rows, rows)], -1, 1)).mean() - shared[:, None] - shared[None, :]
    return normal, np.einsum("kcp,kl,lcq->pq", j, own, j, optimize=True)


def _inverted(precision: np.ndarray) -> tuple[np.ndarray, bool, np.ndarray]:
    """The inverse, whether it is singular, and the direction that is known worst."""
    diagonal = np.diag(precision)
    scale = np.sqrt(np.maximum(diagonal, np.finfo(float).tiny))
    eigenvalues, vectors = np.linalg.eigh(precision / np.outer(scale, scale))
    singular = bool(eigenvalues[0] < 1e-10 or diagonal.min() <= 1e-20 * diagonal.max())
    with np.errstate(over="ignore"):  # what moves nothing is known to no digit at all
        inverse = (vectors / np.maximum(eigenvalues, 1e-12)) @ vectors.T / np.outer(scale, scale)
    return inverse, singular, vectors[:, 0] / scale


def autocorrelation(residual: np.ndarray, seen: np.ndarray, count: int) -> np.ndarray:
    """Autocorrelations (count,) of residuals (T, M, 3) over time, from lag 0; 0 where nothing was seen so far apart."""
    known = np.where(seen[..., None], residual, 0.0)
    square = (known**2).sum() / max(seen.sum(), 1)
    found = np.zeros(min(count, len(known)))
    for lag in range(len(found)):
        both = (seen[lag:] & seen[: len(seen) - lag]).sum()
        if both and square > 0:
            found[lag] = (known[lag:] * known[: len(known) - lag]).sum() / both / square
    return found


def ringing_frequency(times: np.ndarray, positions: np.ndarray) -> float:
    """The strongest frequency [Hz] of evenly spaced positions (T, M, 3) about their late mean; 0 where nothing
    rings."""
    rest = positions[len(positions) // 2 :].mean(axis=0)
    signal = (positions - rest).reshape(len(times), -1)
    power = (np.abs(np.fft.rfft(signal, n=8 * len(times), axis=0)) ** 2).sum(axis=1)
    spacing = float(np.median(np.diff(times)))
    frequencies = np.fft.rfftfreq(8 * len(times), spacing)
    peaks = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    return float(frequencies[peaks[np.argmax(power[peaks])]]) if peaks.size else 0.0
