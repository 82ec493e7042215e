"""Recordings of markers: read, checked, written; NumPy on the host."""

import csv
import dataclasses
import pathlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.errors import FitError

AXES = ("x", "y", "z")


@dataclasses.dataclass(frozen=True)
class Recording:
    """Places of markers over time: `times` (T,) [s], `positions` (T, M, 3) [m], NaN where a sample is missing, `names`.

    Any rigid frame. Of pixels of one camera (`unit` "px") positions are (u, v, 0) and `camera` (3, 4) takes places
    (x, y, z, 1) [m] to (u w, v w, w). `source`, `unit`, `notes`: format and unit of the file it comes from, what was
    left out or repaired. FitError where it is empty, the times do not increase, or shapes do not match.
    """

    times: Any
    positions: Any
    names: Sequence[str]
    notes: tuple[str, ...] = ()
    source: str = ""
    unit: str = "m"
    camera: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", np.asarray(self.times, dtype=np.float64))
        object.__setattr__(self, "positions", np.asarray(self.positions, dtype=np.float64))
        object.__setattr__(self, "names", tuple(self.names))
        rows, count = len(self.times), len(self.names)
        if count == 0:
            raise FitError("the recording holds no marker: give at least one, as columns NAME_x_m, NAME_y_m, NAME_z_m")
        if rows < 2:
            raise FitError(f"the recording holds {rows} rows; a motion needs at least two")
        if len(set(self.names)) < count:
            raise FitError(f"two markers of the recording share a name: {', '.join(self.names)}")
        if self.positions.shape != (rows, count, 3):
            raise FitError(
                f"positions have shape {self.positions.shape}; {rows} times and {count} markers need {(rows, count, 3)}"
            )
        if np.isinf(self.positions).any():
            raise FitError("positions hold an infinite value; mark missing samples with NaN (a blank cell in a file)")
        self._check_times()
        if self.camera is not None:
            self._check_camera()

    def _check_camera(self) -> None:
        try:
            camera = np.asarray(self.camera, dtype=np.float64)
        except (TypeError, ValueError):
            camera = np.full((3, 4), np.nan)
        if self.unit != "px":
            raise FitError(
                f"a camera is given, and the recording holds places in {self.unit}, not pixels: leave it out"
            )
        if camera.shape != (3, 4) or not np.isfinite(camera).all() or np.linalg.matrix_rank(camera) < 3:
            raise FitError(
                f"the camera is {self.camera!r}; give its matrix (3, 4), intrinsic [R | t], that takes (x, y, z, 1) "
                "in m to (u w, v w, w) in pixels"
            )
        object.__setattr__(self, "camera", camera)

    def _check_times(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.times))
        if bad.size:
            raise FitError(f"time of row {bad[0]} is {self.times[bad[0]]}; every row needs its time in seconds")
        bad = np.flatnonzero(np.diff(self.times) <= 0)
        same = int((np.diff(self.times) == 0).sum())
        if same > max(5, 0.1 * len(self.times)) and same == bad.size:
            raise FitError(
                f"{same} rows have the time of the row before ({self.times[bad[0]]:g} s in row {bad[0] + 1}): times "
                "are rounded, or rows are there twice; write more digits, or count rows and give their rate"
            )
        if bad.size:
            raise FitError(
                f"time goes from {self.times[bad[0]]:g} s to {self.times[bad[0] + 1]:g} s at row {bad[0] + 1}: times "
                "must increase; sort the rows and drop repeated ones"
            )

    @property
    def seen(self) -> np.ndarray:
        """Which samples are there, (T, M); one missing coordinate makes the sample missing."""
        return np.asarray(np.isfinite(self.positions).all(axis=-1))

    @property
    def spacing(self) -> float:
        """The usual time between two rows [s]; where the rate changes, that of the faster part."""
        steps = np.diff(self.times)
        usual, shorter = np.median(steps), np.quantile(steps, 0.1)
        return float(shorter if shorter < 0.75 * usual else usual)

    def subset(self, names: Sequence[str]) -> "Recording":
        """The same rows with only these markers, in this order; FitError for a name that is not there."""
        missing = [name for name in names if name not in self.names]
        if missing:
            raise FitError(
                f'the recording has no marker "{missing[0]}" that is ever seen; its markers: {", ".join(self.names)}'
            )
        columns = [self.names.index(name) for name in names]
        return dataclasses.replace(self, positions=self.positions[:, columns], names=tuple(names))


def read_recording(path: Any, *, unit: str | None = None, rate: float | None = None, camera: Any = None) -> Recording:
    """Read markers as motion-capture software writes them; the format is found by the content.

    Motive, Nexus, Qualisys, TRC, C3D (needs ezc3d), Anipose, DeepLabCut, and plain tables with the columns time_s,
    NAME_x_m, NAME_y_m, NAME_z_m (any separator, decimal comma, encoding; units by suffix; blank cells are missing).
    What a file leaves open: `unit` of its lengths ("mm"), `rate` [1/s] of its frames, `camera` (3, 4) of its pixels.
    FitError with file, format and place for what cannot be read.
    """
    from jaxfem.fitting.formats import FORMATS, Request
    from jaxfem.fitting.formats.content import load

    content = load(pathlib.Path(path))
    formats = sorted((each for each in FORMATS.classes()), key=lambda each: each.fallback)
    for each in formats:
        if each.claims(content):
            return each.read(content, Request(unit, rate, camera))
    known = ", ".join(each.title for each in formats)
    raise FitError(f"{path} is not text and none of the known formats ({known}): export it as one of them")


def write_recording(path: Any, recording: Recording, digits: int = 9) -> None:
    """Write a CSV file that `read_recording` reads; missing samples become blank cells."""
    with pathlib.Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", *(f"{name}_{axis}_m" for name in recording.names for axis in AXES)])
        for time, row in zip(recording.times, recording.positions, strict=True):
            cells = ["" if np.isnan(value) else f"{value:.{digits}g}" for value in row.ravel()]
            writer.writerow([f"{time:.{digits}g}", *cells])


def rows_in_words(flags: np.ndarray, recording: Recording) -> str:
    """ "3 samples from 0.1 s on"."""
    first = recording.times[int(np.argmax(flags))]
    count = int(flags.sum())
    return f"{count} sample{'s' if count > 1 else ''} from {first:g} s on"
