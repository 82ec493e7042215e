"""From a recording to what is compared: samples since the release, in the body's frame as far as that is known."""

import dataclasses
from typing import Any

import numpy as np

from jaxfem.declared.errors import checked_choice
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.frames import check_frame, rigid_fit
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.release import FEW, found_release, settled_row

FRAMES = ("none", "rest", "all")
COMPARISONS = ("displacement", "position")
SLACK = 1e-6  # of the sample spacing


@dataclasses.dataclass(frozen=True)
class Measurement:
    """Samples from the release on: `times` (T,) [s] since then, `positions` (T, M, 3) [m], `seen` (T, M), `origin` (M,
    3) the places before the release, the median of `still_rows` (M,) samples, `spacing` [s] of the samples; `left_out`
    names markers without an origin; `free_origin`: it is no better known than any sample, and found with the fit;
    `begins` (3,): time of the release in the recording [s], and the interval that holds it; `stood` (M, 3): the places
    before the release as they were recorded, NaN where unknown; `still` (n, M, 3): the samples before the release that
    tell the origin, less it [m], NaN where not seen, in the rows `still_when` (n,), counted from the release."""

    times: np.ndarray
    positions: np.ndarray
    seen: np.ndarray
    origin: np.ndarray
    still_rows: np.ndarray
    spacing: float
    left_out: tuple[str, ...] = ()
    free_origin: bool = False
    begins: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stood: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    still: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0, 3)))
    still_when: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, int))

    @property
    def displacement_scale(self) -> float:
        """Root mean square displacement from the origin [m]."""
        square = ((self.positions - self.origin) ** 2).sum(axis=-1)[self.seen]
        return float(np.sqrt(square.mean()))


def measurement(
    recording: Recording, nominal: np.ndarray, *, frame: str, compare: str, release: Any, end: Any
) -> Measurement:
    """Cut a recording to the motion and turn it into the body's frame.

    `nominal` (M, 3): the markers' places on the body at the start. `frame`, `compare`, `release`, `end` as in `fit`.
    """
    checked_choice("frame", frame, FRAMES, FitError)
    checked_choice("compare", compare, COMPARISONS, FitError)
    if recording.unit == "px" and (recording.camera is None or frame != "none"):
        raise FitError(
            "the recording holds pixels: "
            + (f'frame = "{frame}" needs places; use "none"' if frame != "none" else "give its camera = (3, 4) matrix")
            + ", which takes places in the body's frame to pixels"
        )
    first, earliest, latest = _released(recording, release, end)
    last = _end(recording, end, first)
    if last - first < 2:
        raise FitError(
            f"only {last - first} rows lie between the release at {recording.times[first]:g} s and the end: give "
            "another release or end"
        )
    still = slice(0, first + 1) if compare == "displacement" or frame == "rest" else slice(first, first + 1)
    origin, still_rows = _origin(recording, still, first)
    stood = _origin(recording, slice(0, first + 1), first)[0]
    positions = recording.positions[first:last]
    before = np.arange(_first_still(first) if still.start == 0 else first, first)
    quiet = recording.positions[before] - origin
    if frame == "rest":
        known = np.isfinite(origin).all(axis=1)
        check_frame(nominal[known], 'frame = "rest"')
        rotation, translation = (np.asarray(a) for a in rigid_fit(origin, nominal, known.astype(float)))
        positions, origin = positions @ rotation.T + translation, origin @ rotation.T + translation
        quiet = quiet @ rotation.T
    elif frame == "all":
        check_frame(nominal, 'frame = "all"')
    free_origin = compare == "displacement" and first < FEW
    if compare == "position" or free_origin:  # any guess will do: only the size of the motion depends on it
        origin = np.where(np.isfinite(origin), origin, np.nanmedian(positions, axis=0))
    known = np.isfinite(origin).all(axis=1)
    seen = recording.seen[first:last] & known
    if not seen.any():
        raise FitError(
            "no marker is seen both before and after the release: give another release or end, or compare by position"
        )
    times = recording.times[first:last] - recording.times[first]
    filled = np.where(seen[..., None], positions, 0.0)
    left_out = tuple(name for name, there in zip(recording.names, known, strict=True) if not there)
    times_of = recording.times
    begins = (float(times_of[first]), float(times_of[earliest]), float(times_of[latest]))
    return Measurement(
        times=times,
        positions=filled,
        seen=seen,
        origin=np.nan_to_num(origin),
        still_rows=still_rows,
        spacing=recording.spacing,
        left_out=left_out,
        free_origin=free_origin,
        begins=begins,
        stood=stood,
        still=quiet,
        still_when=np.round((times_of[before] - times_of[first]) / recording.spacing).astype(int),
    )


def release_index(recording: Recording, release: Any) -> tuple[int, int, int]:
    """The row of the release, found or at the time that `release` gives [s], and the first and last that it may be."""
    if isinstance(release, str):
        if release != "auto":
            raise FitError(f'release is {release!r}; give "auto" or a time in s')
        found = found_release(recording)
        return found.row, found.low, found.high
    slack = SLACK * recording.spacing
    if not recording.times[0] - slack <= release <= recording.times[-1]:
        raise FitError(
            f"release = {release:g} s is outside the recording, which runs from {recording.times[0]:g} to "
            f"{recording.times[-1]:g} s"
        )
    row = int(np.argmin(np.abs(recording.times - release)))  # the nearest one
    return row, row, row


def _released(recording: Recording, release: Any, end: Any) -> tuple[int, int, int]:
    """`release_index` of the rows up to `end`."""
    rows = _until(recording, end)
    try:
        return release_index(rows, release)
    except FitError as flaw:
        if len(rows.times) == len(recording.times):
            raise
        raise FitError(f"up to end = {end:g} s {flaw}: end is not after the release, or too near to it") from flaw


def _until(recording: Recording, end: Any) -> Recording:
    """The rows up to a time `end`: what is behind it says nothing of the release."""
    if end is None or isinstance(end, str):
        return recording
    rows = max(2, int(np.searchsorted(recording.times, end + SLACK * recording.spacing, side="right")))
    return dataclasses.replace(recording, times=recording.times[:rows], positions=recording.positions[:rows])


def _end(recording: Recording, end: Any, first: int) -> int:
    """One past the last row used."""
    if end is None:
        return len(recording.times)
    if isinstance(end, str):
        if end != "settled":
            raise FitError(f'end is {end!r}; give "settled", a time in s, or nothing for the whole recording')
        return max(settled_row(recording), first + 2)
    if end <= recording.times[first]:
        raise FitError(f"end = {end:g} s is not after the release at {recording.times[first]:g} s")
    return int(np.searchsorted(recording.times, end + SLACK * recording.spacing, side="right"))


def _origin(recording: Recording, still: slice, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Place of each marker before the release (M, 3), NaN where it was never seen, and the number of samples (M,).

    The median, not the mean: a marker that the camera loses for a while jumps when it is found again.
    """
    seen = recording.seen[still]
    if still.start == 0:
        seen[: _first_still(first)] = False
    counts = seen.sum(axis=0)
    origin = np.full(recording.positions.shape[1:], np.nan)
    for marker in np.flatnonzero(counts):
        origin[marker] = np.median(recording.positions[still][seen[:, marker], marker], axis=0)
    return origin, counts


def _first_still(first: int) -> int:
    """The first row that tells the origin: hands drift, so only the second half of a long wait is taken."""
    return 0 if first < 2 else (first + 1) // 2
