"""Solvers on plain arrays and callables; nothing here knows of meshes or bodies."""

from jaxfem.solvers.mprgp import mprgp
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.pgs import pgs
from jaxfem.solvers.status import SolveInfo, Status, describe

__all__ = ["SolveInfo", "Status", "describe", "mprgp", "pcg", "pgs"]
