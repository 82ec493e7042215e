"""Fitting: material values of a soft body from a recording of markers on it."""

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers, attach, marker_positions
from jaxfem.fitting.recording import Recording, read_recording, write_recording
from jaxfem.fitting.recovery import FitResult, fit
from jaxfem.fitting.search import Search

__all__ = [
    "FitError",
    "FitResult",
    "Markers",
    "Recording",
    "Search",
    "attach",
    "fit",
    "marker_positions",
    "read_recording",
    "write_recording",
]
