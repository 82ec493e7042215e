"""Do markers move the way that one simulation at the start says? Signs and columns of axes, markers that stand.

How far a body moves depends on its stiffness, which way, and how markers share in it, hardly does. Compared is the mean
of each marker's displacement over time.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.measurement import Measurement
from jaxfem.fitting.place_checks import axis_changes

AGAINST = -0.5  # cosine between recorded and simulated motion, below which they are opposed
ACROSS = 0.5  # such a cosine at most, where other axes of the recording give one of ALONG, is of columns exchanged
ALONG = 0.9
ASTRAY = 0.3  # such a cosine at most is of another motion, whatever the axes
ONE_WAY = 0.3  # share of a motion that its mean must be, to tell a direction
MUCH = 0.3  # of the motion of the marker that moves most
STANDS = 0.1  # of the share that the others have in their simulated motion


def direction_faults(
    simulated: np.ndarray,
    measured: Measurement,
    names: Sequence[str],
    compare: str,
    sure: bool = True,
    alike: bool = True,
    unit: str = "m",
) -> list[str]:
    """Faults of `simulated` (T, M, 3) against what was recorded. `sure`: nothing is fitted that turns the motion;
    `alike`: nothing that makes one marker move less and another more."""
    seen = measured.seen[..., None]
    count = np.maximum(seen.sum(axis=0), 1)
    origin = measured.origin
    if measured.free_origin or compare == "position":  # the origin is any guess there: the first sample of each marker
        origin = np.take_along_axis(measured.positions, np.argmax(measured.seen, axis=0)[None, :, None], axis=0)[0]
    moved = np.where(seen, measured.positions - origin, 0.0)
    should = np.where(seen, simulated - simulated[0], 0.0)
    real, told = moved.sum(axis=0) / count, should.sum(axis=0) / count
    scale = np.linalg.norm(real) * np.linalg.norm(told)
    if scale == 0:
        return []
    cosine = float((real * told).sum() / scale)
    if cosine <= AGAINST:
        return [_against(real, told, cosine)]
    if sure and cosine <= ACROSS and all(_goes_one_way(each, count) for each in (moved, should)):
        if faults := _across(real, told, cosine, unit):
            return faults
    if cosine <= 0:
        return []
    return _one_against(real, told, names) or (_one_stands(real, told, names, unit) if alike else [])


def _goes_one_way(moved: np.ndarray, count: np.ndarray) -> bool:
    """Whether a motion (T, M, 3) has a mean, by `count` (M, 1) samples, that is a good part of it."""
    mean, square = moved.sum(axis=0) / count, (moved**2).sum(axis=0) / count
    return float(np.linalg.norm(mean)) > ONE_WAY * float(np.sqrt(square.sum()))


def _against(real: np.ndarray, told: np.ndarray, cosine: float) -> str:
    axes: Any = [axis for axis, a, b in zip("xyz", real.sum(axis=0), told.sum(axis=0), strict=True) if a * b < 0]
    return (
        f"the axes: the markers move against what the scene's loads make the body do (cosine {cosine:.2f}; along "
        f"{', '.join(axes) or 'all axes'}): turn the sign of that axis in the recording, or of gravity or the loads"
    )


def _across(real: np.ndarray, told: np.ndarray, cosine: float, unit: str) -> list[str]:
    """Markers that move across the simulated motion, as they do where columns of axes are exchanged."""
    scale = np.linalg.norm(real) * np.linalg.norm(told)
    for turned, words in axis_changes():
        if float(((real @ turned.T) * told).sum()) > ALONG * scale:
            return [f"{words}: as they are, markers move across what the scene's loads make the body do"]
    if cosine > ASTRAY:
        return []
    one, other = (", ".join(_length(float(each), unit) for each in mean.mean(axis=0)) for mean in (real, told))
    return [
        f"the motion: markers move by ({one}) along x, y, z on the whole, where the scene's loads make them move by "
        f"({other}): see the axes of the recording, gravity and the loads"
    ]


def _one_against(real: np.ndarray, told: np.ndarray, names: Sequence[str]) -> list[str]:
    """Single markers that move against their simulated motion, among those that move much."""
    far, near = np.linalg.norm(told, axis=1), np.linalg.norm(real, axis=1)
    cosines = (real * told).sum(axis=1) / np.maximum(far * near, np.finfo(float).tiny)
    much = (far > MUCH * far.max()) & (near > MUCH * near.max())
    return [
        f'the places: "{names[k]}" moves against its simulated motion (cosine {cosines[k]:.2f}) while the others move '
        "along: see its name, its place and its columns"
        for k in np.flatnonzero(much & (cosines < AGAINST)).tolist()
    ]


def _one_stands(real: np.ndarray, told: np.ndarray, names: Sequence[str], unit: str) -> list[str]:
    """Markers that stand still while others move, and that should move about as much as these."""
    far = np.linalg.norm(told, axis=1)
    shares = (real * told).sum(axis=1) / np.maximum(far**2, np.finfo(float).tiny)
    much = far > MUCH * far.max()
    found = []
    for k in np.flatnonzero(much).tolist():
        others = much & (np.arange(len(names)) != k)
        usual = float(np.median(shares[others])) if others.any() else 0.0
        if abs(shares[k]) < STANDS * usual:
            found.append(
                f'the marker "{names[k]}" moves by {_length(float(shares[k] * far[k]), unit)} on the whole, where the '
                f"others say {_length(float(usual * far[k]), unit)}: it is stuck, is fixed to what stands still, or is "
                "another marker. See its name and its columns, or leave it out"
            )
    return found


def _length(value: float, unit: str) -> str:
    return f"{1e3 * value:.2g} mm" if unit == "m" else f"{value:.2g} {unit}"
