"""Data beside markers, each kind a file that registers itself: frequencies, settled shapes, forces, gauges."""

from jaxfem.fitting.beside.base import KINDS, At, Datum, Probe
from jaxfem.fitting.beside.rows import Beside, DataOf, data_of
from jaxfem.registry import import_folder

import_folder(__name__, __path__)

__all__ = ["KINDS", "At", "Beside", "DataOf", "Datum", "Probe", "data_of"]
