"""Tetrahedral meshes: made, read, checked, measured. NumPy on the host; nothing here is traced by JAX."""

from .cad import from_cad
from .cages import cage
from .checks import MeshWarning
from .clouds import delaunay, from_convex_surface
from .embedding import locate
from .files import from_cells, read, read_surface, write
from .filling import from_surface
from .generators import ball, beam, box
from .quality import QualityReport, quality, report_text
from .refining import refined
from .tet import MeshError, TetMesh

__all__ = [
    "MeshError",
    "MeshWarning",
    "QualityReport",
    "TetMesh",
    "ball",
    "beam",
    "box",
    "cage",
    "delaunay",
    "from_cad",
    "from_cells",
    "from_convex_surface",
    "from_surface",
    "locate",
    "quality",
    "read",
    "read_surface",
    "refined",
    "report_text",
    "write",
]
