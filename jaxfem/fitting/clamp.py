"""Markers on the clamp: they tell where the body's frame is in the recording, and nothing else."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.frames import check_frame, rigid_fit
from jaxfem.fitting.place_checks import place_faults
from jaxfem.fitting.recording import Recording
from jaxfem.fitting.release import scatter
from jaxfem.fitting.repairs import repaired

RESTLESS = 5.0  # times their scatter: clamp markers that move by more are told of


def in_frame_of_clamp(
    recording: Recording, clamp: Mapping[str, Any] | None, markers: Sequence[str], frame: str
) -> tuple[Recording, list[str]]:
    """The recording in the frame of the mesh, and notes: `clamp`, name -> place (3,) [m] in that frame, of markers that
    stand still throughout. Their places are medians over all rows. As it is without a clamp; FitError where the clamp's
    markers cannot tell a frame, or stand otherwise than is said."""
    if not clamp:
        return recording, []
    both = [name for name in clamp if name in markers]
    if both:
        raise FitError(
            f'"{both[0]}" is named among the markers and on the clamp: markers on the clamp are for the frame only'
        )
    if frame != "none" or recording.unit == "px":
        what = f'frame = "{frame}"' if frame != "none" else "a recording of pixels"
        raise FitError(f'markers on the clamp tell the frame, beside {what}: leave one of them out (frame = "none")')
    given = _given(clamp)
    check_frame(given, "the frame of the clamp's markers")
    still = repaired(recording.subset(tuple(clamp)))
    unseen = [name for number, name in enumerate(clamp) if not still.seen[:, number].any()]
    if unseen:
        raise FitError(f'"{unseen[0]}" on the clamp is never seen: leave it out')
    stood = np.nanmedian(still.positions, axis=0)
    faults, notes = place_faults(stood, given, tuple(clamp), "rest", "displacement")
    if faults:
        raise FitError(f"the clamp's markers do not stand where they are said to. {'; '.join(faults)}")
    turn, shift = (np.asarray(a, np.float64) for a in rigid_fit(stood, given, np.ones(len(given))))
    positions = recording.positions @ turn.T + shift
    return dataclasses.replace(recording, positions=positions), [*_restless(still), *notes]


def _given(clamp: Mapping[str, Any]) -> np.ndarray:
    for name, place in clamp.items():
        array = np.asarray(place, np.float64) if np.shape(place) == (3,) else np.full(3, np.nan)
        if not np.isfinite(array).all():
            raise FitError(f'the place of "{name}" on the clamp is {place!r}; give three finite numbers in m')
    return np.array([np.asarray(place, np.float64) for place in clamp.values()])


def _restless(still: Recording) -> list[str]:
    """A note of how far the clamp's markers move, where that is more than their noise."""
    off = still.positions - np.nanmedian(still.positions, axis=0)
    lines = [line[np.isfinite(line)] for line in off.reshape(len(off), -1).T]
    noise = max((scatter(line) for line in lines if line.size), default=0.0)
    far = float(np.nanquantile(np.linalg.norm(off, axis=-1), 0.98))
    if far <= max(RESTLESS * noise, 1e-9):
        return []
    return [f"the clamp's markers move by {1e3 * far:.2g} mm: the frame is that of their median places"]
