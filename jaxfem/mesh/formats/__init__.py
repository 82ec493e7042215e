"""Readers of mesh files, one format a module, found by the file's ending. Formats without one here go through meshio.

A reader is a function path -> `RawMesh`; it may raise anything, which `files.read` turns into a MeshError.
"""

from collections.abc import Callable
from pathlib import Path

from ..raw import RawMesh
from .abaqus import read_abaqus
from .gmsh import read_gmsh
from .tetgen import read_tetgen
from .vtk import read_vtk
from .vtu import read_vtu
from .wavefront import read_obj

READERS: dict[str, Callable[[Path], RawMesh]] = {
    ".inp": read_abaqus,
    ".msh": read_gmsh,
    ".node": read_tetgen,
    ".ele": read_tetgen,
    ".obj": read_obj,
    ".vtk": read_vtk,
    ".vtu": read_vtu,
}
