"""What the residuals at the end of a fit say: scatter, error bars, correlations."""

import dataclasses

import numpy as np

OPEN_CORRELATION = 0.995


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """`covariance` (P, P) of the free numbers z, `noise` (the residuals' scatter, in units of sigma), `inflation`: how
    many neighbouring samples tell the same, `singular`: whether some combination of the unknowns is not seen at all."""

    covariance: np.ndarray
    noise: float
    inflation: float
    singular: bool

    @property
    def correlation(self) -> np.ndarray:
        """Correlation (P, P)."""
        spread = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.maximum(np.outer(spread, spread), np.finfo(float).tiny))


def uncertainty(
    residual: np.ndarray,
    jacobian: np.ndarray,
    seen: np.ndarray,
    still_rows: np.ndarray | None,
    constants: int,
    axes: int = 3,
) -> Uncertainty:
    """Error bars from residuals (T, M, 3) and Jacobian (P, T, M, 3); `seen` (T, M).

    Linear least squares about the solution, cov = s^2 (J'J)^-1, times the residuals' integrated autocorrelation time:
    what a model leaves unexplained is smooth in time, and T samples of it are fewer independent ones. Displacements
    from a place that is itself the median of `still_rows` (M,) samples share its scatter: None where they do not.
    `constants`: further unknowns (a frame, places of origin) that were found along the way. `axes`: coordinates of
    a sample, 2 of pixels. Seber & Wild 1989,
    chapters 5 and 6.
    """
    count = len(jacobian)
    columns = jacobian.reshape(count, -1)
    freedom = max(axes * int(seen.sum()) - count - constants, 1)
    variance = float((residual**2).sum() / freedom)
    normal = columns @ columns.T
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal / np.outer(scale, scale)
    eigenvalues, vectors = np.linalg.eigh(scaled)
    singular = bool(eigenvalues[0] < 1e-10 or np.diag(normal).min() <= 1e-20 * np.diag(normal).max())
    inverse = (vectors / np.maximum(eigenvalues, 1e-12)) @ vectors.T / np.outer(scale, scale)
    share = np.zeros(residual.shape[1])
    if still_rows is not None:
        share = 0.5 * np.pi / np.maximum(still_rows, 1)  # variance of a median
    inflation = autocorrelation_time(residual, seen, float(share.mean()))
    shared = jacobian.sum(axis=1)  # (P, M, 3): one error of the origin moves all samples of a marker alike
    middle = inflation * normal + np.einsum("pmi,qmi,m->pq", shared, shared, share)
    return Uncertainty(variance * inverse @ middle @ inverse, float(np.sqrt(variance)), inflation, singular)


def autocorrelation_time(residual: np.ndarray, seen: np.ndarray, share: float = 0.0) -> float:
    """1 + 2 sum of the autocorrelations of residuals (T, M, 3) over time, up to the first near zero; >= 1.

    `share`: variance of an error common to all samples of a marker, relative to one sample's; accounted for elsewhere.
    """
    squares, pairs = float((residual**2).sum()), float(seen.sum())
    if squares == 0:
        return 1.0
    total = 1.0
    for lag in range(1, len(residual) // 2):
        both = float((seen[lag:] & seen[:-lag]).sum())
        if both == 0:
            break
        correlation = (residual[lag:] * residual[:-lag]).sum() / both / (squares / pairs) - share / (1 + share)
        if correlation < 0.05:
            break
        total += 2 * correlation
    return float(total)


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
