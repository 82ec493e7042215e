"""Sweeps: one scene with many values, chunk by chunk, a status for each variant."""

from jaxfem.sweeping.chunks import Sweep, sweep
from jaxfem.sweeping.errors import SweepError
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
    "latin_hypercube",
    "random",
    "sweep",
    "table",
]
