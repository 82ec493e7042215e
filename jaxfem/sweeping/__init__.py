"""Sweeps: one scene with many values, chunk by chunk, a status for each variant."""

from jaxfem.sweeping.chunks import Sweep, sweep
from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.indices import indices_of, sensitivity_indices, sobol
from jaxfem.sweeping.outputs import OUTPUTS, Observed, Output
from jaxfem.sweeping.result import SweepResult
from jaxfem.sweeping.samples import grid, latin_hypercube, random, table

__all__ = [
    "OUTPUTS",
    "Observed",
    "Output",
    "Sweep",
    "SweepError",
    "SweepResult",
    "grid",
    "indices_of",
    "latin_hypercube",
    "random",
    "sensitivity_indices",
    "sobol",
    "sweep",
    "table",
]
