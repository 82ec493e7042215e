"""Fitting: material values of a soft body from a recording of markers on it."""

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.markers import Markers, attach, marker_positions
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.priors import Gaussian, LogNormal
from jaxfem.fitting.recording import Recording, read_recording, write_recording
from jaxfem.fitting.recovery import fit, fit_takes
from jaxfem.fitting.result import FitResult, TakeFit
from jaxfem.fitting.search import Search
from jaxfem.fitting.takes import Take

__all__ = [
    "FitError",
    "FitResult",
    "Gaussian",
    "LogNormal",
    "Markers",
    "Noise",
    "Recording",
    "Search",
    "Take",
    "TakeFit",
    "attach",
    "fit",
    "fit_takes",
    "marker_positions",
    "read_recording",
    "write_recording",
]
