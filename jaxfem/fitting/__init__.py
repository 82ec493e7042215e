"""Fitting: material values of a soft body from a recording of markers on it."""

from jaxfem.fitting.after import contributions, profile
from jaxfem.fitting.agreement import Agreement
from jaxfem.fitting.asked import Contribution, Posterior, Profile, Refinement
from jaxfem.fitting.beside.frequencies import Frequencies
from jaxfem.fitting.beside.gauge import Gauge
from jaxfem.fitting.beside.settled import Settled
from jaxfem.fitting.beside.supports import SupportForce
from jaxfem.fitting.errors import FitError
from jaxfem.fitting.fields import FieldFit, fit_field
from jaxfem.fitting.markers import Markers, attach, marker_positions
from jaxfem.fitting.noise import Noise
from jaxfem.fitting.posterior import sample
from jaxfem.fitting.priors import Gaussian, LogNormal
from jaxfem.fitting.recording import Recording, read_recording, write_recording
from jaxfem.fitting.recovery import fit, fit_takes
from jaxfem.fitting.refining import refine
from jaxfem.fitting.result import FitResult, TakeFit
from jaxfem.fitting.search import Search
from jaxfem.fitting.sensitivity import sensitivity
from jaxfem.fitting.silicones import silicone
from jaxfem.fitting.takes import Take
from jaxfem.fitting.takes_alone import alone

__all__ = [
    "Agreement",
    "Contribution",
    "FieldFit",
    "FitError",
    "FitResult",
    "Frequencies",
    "Gauge",
    "Gaussian",
    "LogNormal",
    "Markers",
    "Noise",
    "Posterior",
    "Profile",
    "Recording",
    "Refinement",
    "Search",
    "Settled",
    "SupportForce",
    "Take",
    "TakeFit",
    "alone",
    "attach",
    "contributions",
    "fit",
    "fit_field",
    "fit_takes",
    "marker_positions",
    "profile",
    "read_recording",
    "refine",
    "sample",
    "sensitivity",
    "silicone",
    "write_recording",
]
