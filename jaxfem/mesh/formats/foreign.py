"""meshio, and nothing else of it anywhere: formats without a reader of their own, and all that is written.

It has had no release since January 2024; what it reads wrongly gets a reader of its own in this folder.
"""

import contextlib
import io
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import Ints, MeshError
from ..raw import Members, RawMesh, sets_of_tags

TAGS = ("gmsh:physical", "medit:ref", "tetgen:ref", "nastran:ref", "su2:tag")  # where formats keep a cell's number
ADVICE = "is the file complete, and its ending right?"
VTK_NAMES = {  # cells of any order, corners first
    "VTK_LAGRANGE_CURVE": "line",
    "VTK_LAGRANGE_TRIANGLE": "triangle",
    "VTK_LAGRANGE_QUADRILATERAL": "quad",
    "VTK_LAGRANGE_TETRAHEDRON": "tetra",
    "VTK_LAGRANGE_HEXAHEDRON": "hexahedron",
    "VTK_LAGRANGE_WEDGE": "wedge",
    "VTK_LAGRANGE_PYRAMID": "pyramid",
}


def endings() -> list[str]:
    """All endings of files that meshio knows."""
    import meshio

    return sorted(meshio.extension_to_filetypes)


def read_foreign(path: Path) -> RawMesh:
    """A mesh file as meshio reads it."""
    import meshio

    raw = _nastran(path) if path.suffix.lower() in (".bdf", ".nas", ".fem") else meshio.read(path)
    blocks = [(VTK_NAMES.get(block.type, block.type), np.asarray(block.data)) for block in raw.cells]
    mesh = RawMesh(raw.points, blocks)
    for key in TAGS:
        if key in raw.cell_data:
            # Gmsh's own field_data: name -> (number, dimension)
            pairs = {name: np.ravel(value) for name, value in raw.field_data.items() if np.size(value) == 2}
            names = {(int(value[1]), int(value[0])): str(name) for name, value in pairs.items()}
            mesh.cell_sets |= sets_of_tags(blocks, raw.cell_data[key], names)
            break
    for name, members in raw.cell_sets.items():
        if not name.startswith("gmsh:"):
            mesh.cell_sets[str(name)] = [
                (i, np.asarray(numbers, np.int64)) for i, numbers in enumerate(members) if numbers is not None
            ]
    mesh.node_sets |= {str(name): np.asarray(numbers, np.int64) for name, numbers in raw.point_sets.items()}
    _families(raw, mesh)
    return mesh


def _nastran(path: Path) -> Any:
    """Nastran's cards, also without the line that announces them, as Gmsh and others write them."""
    import meshio

    text = path.read_text(errors="replace")
    if "BEGIN BULK" not in text:
        text = "BEGIN BULK\n" + text + ("" if "ENDDATA" in text else "\nENDDATA\n")
    return meshio.read(io.StringIO(text), file_format="nastran")


def _families(raw: Any, mesh: RawMesh) -> None:
    """Groups of Salome's .med files: each number of a family stands for the names of some groups."""
    for tag, names in getattr(raw, "cell_tags", {}).items():
        for name in names:
            members: Members = mesh.cell_sets.setdefault(str(name).strip(), [])
            for i, values in enumerate(raw.cell_data.get("cell_tags", [])):
                members.append((i, np.flatnonzero(np.asarray(values) == tag)))
    tags = np.asarray(raw.point_data.get("point_tags", []))
    nodes: dict[str, list[Ints]] = {}
    for tag, names in getattr(raw, "point_tags", {}).items():
        for name in names:
            nodes.setdefault(str(name).strip(), []).append(np.flatnonzero(tags == tag))
    mesh.node_sets |= {name: np.concatenate(each) for name, each in nodes.items()}


def write_foreign(
    path: Path,
    points: Any,
    blocks: Sequence[tuple[str, Any]],
    point_data: Mapping[str, Any] | None = None,
    cell_data: Mapping[str, Sequence[Any]] | None = None,
    names: Mapping[str, Any] | None = None,
    **options: Any,
) -> None:
    """Write a file in the format of its ending, or of `file_format`; values of cells: one array a block."""
    import meshio

    mesh = meshio.Mesh(points, blocks, dict(point_data or {}), dict(cell_data or {}), field_data=dict(names or {}))
    meshio.write(path, mesh, **options)


def read_block(path: Path) -> tuple[Any, str, Any, dict[str, Any], dict[str, Any]]:
    """Points, kind and cells of the first block, and values of points and of these cells, of a file."""
    import meshio

    raw = meshio.read(path)
    cells = {name: values[0] for name, values in raw.cell_data.items()}
    if not raw.cells:
        return raw.points, "vertex", np.zeros((0, 1), int), dict(raw.point_data), cells
    return raw.points, raw.cells[0].type, raw.cells[0].data, dict(raw.point_data), cells


def quietly(action: Callable[[], Any], verb: str, path: Path) -> Any:
    """Run a reader or writer, which may print and even exit when it fails; MeshError with what it said instead."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return action()
    except (Exception, SystemExit) as problem:
        if isinstance(problem, FileNotFoundError) or (isinstance(problem, OSError) and problem.filename is not None):
            raise
        if isinstance(problem, ModuleNotFoundError):
            raise MeshError(f"cannot {verb} {path}: this format needs the Python package {problem.name}") from problem
        printed = " ".join(said.getvalue().split()).replace("Error: ", "")
        reason = printed or (str(problem) if not isinstance(problem, SystemExit) else "") or type(problem).__name__
        advice = "" if isinstance(problem, MeshError) else f": {ADVICE}"
        raise MeshError(f"cannot {verb} {path}: {reason}{advice}") from problem
