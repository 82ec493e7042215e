"""Mesh files: read and written through meshio, which knows the formats; what is lost on the way is said."""

import contextlib
import io
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .blocks import LINEAR, solid_points, sort_out
from .checks import Floats, Ints, MeshError, is_positive
from .tet import TetMesh
from .tetgen import read_tetgen
from .wavefront import read_obj

if TYPE_CHECKING:  # slow to import: each function that needs it does so itself
    import meshio

StrPath = str | os.PathLike[str]


def read(path: StrPath, scale: float = 1.0, name: str | None = None) -> TetMesh:
    """The tetrahedra of a mesh file (.msh, .vtu, .vtk, .node or .ele, .inp, .mesh, ...), lengths times `scale`.

    scale=1e-3 reads a file in millimetres; name is the file's stem by default. Named or numbered physical groups, sets
    and markers become face, node and cell groups. Everything left out, made linear or repaired stands in the mesh's
    `notes`. FileNotFoundError for a missing file; MeshError for a file that is of no known format, cannot be read or
    holds no tetrahedra.
    """
    source = _existing(path, scale)
    parts = sort_out(_raw(source), str(source))
    return TetMesh.repaired(
        parts.points * scale,
        parts.cells,
        source.stem if name is None else name,
        parts.face_groups,
        parts.node_groups,
        parts.cell_groups,
        parts.notes,
    )


def read_surface(path: StrPath, scale: float = 1.0) -> tuple[Floats, Ints]:
    """Points (n, 3) and triangles (k, 3) of a surface file (.obj, .stl, .ply, .off, ...); quads are cut in two.

    Points at the same place are merged, as .stl files need. Lengths are multiplied by `scale`. FileNotFoundError and
    MeshError as for `read`; MeshError too for a file without triangles.
    """
    source = _existing(path, scale)
    raw = _raw(source)
    triangles = []
    for block in raw.cells:
        if block.type in ("triangle", "triangle6"):
            triangles.append(np.asarray(block.data, dtype=np.int64)[:, :3])
        elif block.type == "quad":
            triangles += [np.asarray(block.data, dtype=np.int64)[:, corners] for corners in ([0, 1, 2], [0, 2, 3])]
    if not triangles:
        raise MeshError(f"no triangles in {source}: found {', '.join(block.type for block in raw.cells) or 'no cells'}")
    places, merged = np.unique(solid_points(raw.points), axis=0, return_inverse=True)
    faces = merged.reshape(-1)[np.concatenate(triangles)]
    used, numbers = np.unique(faces, return_inverse=True)
    return places[used] * scale, numbers.reshape(-1, 3).astype(np.int64)


def write(
    path: StrPath,
    mesh: TetMesh,
    point_data: Mapping[str, Any] | None = None,
    cell_data: Mapping[str, Any] | None = None,
) -> tuple[str, ...]:
    """Write a mesh, and values a node (n, ...) or an element (m, ...), in the format of the file's ending.

    Returns what the format could not keep, a sentence each: .msh keeps the groups. MeshError for an unknown ending or
    data of the wrong length.
    """
    import meshio

    target = Path(path)
    ending = _ending(target)
    points = _checked(point_data, len(mesh.points), "point", "nodes")
    cells = _checked(cell_data, len(mesh.cells), "cell", "elements")
    if ending in (".node", ".ele"):
        lost = _lost(mesh, ending) + (("TetGen files keep no data on nodes or elements",) if points or cells else ())
        _quietly(lambda: meshio.Mesh(mesh.points, [("tetra", mesh.cells)]).write(target), "write", target)
        return lost
    if ending == ".msh":
        raw, lost = _with_groups(mesh, points)
        _quietly(lambda: meshio.write(target, raw, file_format="gmsh22"), "write", target)
        # meshio cannot read back data on several blocks of cells
        return lost + ((f"cell data {', '.join(cells)} is not kept in .msh files: write .vtu",) if cells else ())
    raw = meshio.Mesh(mesh.points, [("tetra", mesh.cells)], points, {key: [values] for key, values in cells.items()})
    options = {"data_format": "XML"} if ending in (".xdmf", ".xmf") else {}  # one file, and no need for HDF5
    _quietly(lambda: meshio.write(target, raw, **options), "write", target)
    return _lost(mesh, ending)


def _existing(path: StrPath, scale: float) -> Path:
    """The path, if there is such a file of a known kind and the scale is usable."""
    if not is_positive(scale):
        raise MeshError(f"scale={scale!r} for {path}: give one positive number, the file's unit of length in m")
    source = Path(path)
    if not source.is_file():
        folder = source.parent
        if not folder.is_dir():
            raise FileNotFoundError(f"no mesh file {source}: there is no folder {folder.absolute()}")
        near = sorted(each.name for each in folder.iterdir() if each.suffix and each.suffix in _known())[:8]
        holds = f"the folder holds {', '.join(near)}" if near else f"{folder.absolute()} holds no mesh files"
        raise FileNotFoundError(f"no mesh file {source}: {holds}")
    _ending(source)
    return source


def _known() -> list[str]:
    import meshio

    return sorted(meshio.extension_to_filetypes)


def _ending(path: Path) -> str:
    """The file's ending in lower case; MeshError when no format has it."""
    for ending in (path.suffix.lower(), "".join(path.suffixes[-2:]).lower()):
        if ending in _known():
            return ending
    raise MeshError(f'{path} has the ending "{path.suffix}", of no known mesh format: known are {" ".join(_known())}')


def _raw(source: Path) -> "meshio.Mesh":
    import meshio

    if source.suffix.lower() in (".node", ".ele"):
        return read_tetgen(source)
    if source.suffix.lower() == ".obj":
        return read_obj(source)
    return _quietly(lambda: meshio.read(source), "read", source)


def _quietly(action: Callable[[], Any], verb: str, path: Path) -> Any:
    """Run meshio, which prints and even exits when it fails; MeshError with what it printed instead."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return action()
    except (Exception, SystemExit) as problem:
        if isinstance(problem, OSError) and problem.filename is not None:
            raise
        if isinstance(problem, ModuleNotFoundError):
            raise MeshError(f"cannot {verb} {path}: this format needs the Python package {problem.name}") from problem
        printed = " ".join(said.getvalue().split()).replace("Error: ", "")
        reason = printed or (str(problem) if not isinstance(problem, SystemExit) else "") or type(problem).__name__
        advice = "is the file complete, and its ending right?"
        if path.suffix.lower() == ".msh":  # meshio stumbles over version 4.1 where some entities are in no group
            advice += " If Gmsh opens it, save it as version 2.2 (gmsh -save -format msh22)"
        raise MeshError(f"cannot {verb} {path}: {reason}: {advice}") from problem


def _checked(data: Mapping[str, Any] | None, count: int, kind: str, what: str) -> dict[str, np.ndarray]:
    arrays = {name: np.asarray(values) for name, values in (data or {}).items()}
    for name, values in arrays.items():
        if values.ndim == 0 or len(values) != count:
            raise MeshError(
                f'{kind} data "{name}" has shape {values.shape}: its first length must be {count}, the {what}'
            )
    return arrays


def _lost(mesh: TetMesh, ending: str) -> tuple[str, ...]:
    kinds = (("face", mesh.face_groups), ("node", mesh.node_groups), ("cell", mesh.cell_groups))
    return tuple(
        f"{kind} groups {', '.join(groups)} are not kept in {ending} files: write .msh to keep them"
        for kind, groups in kinds
        if groups
    )


def _with_groups(mesh: TetMesh, point_data: dict[str, Any]) -> tuple["meshio.Mesh", tuple[str, ...]]:
    """A Gmsh mesh whose physical groups are the face groups (triangles), node groups (vertices) and cell groups."""
    import meshio

    blocks: list[tuple[str, Ints]] = [("tetra", mesh.cells)]
    names: dict[str, Ints] = {}
    lost: list[str] = []
    own = np.zeros(len(mesh.cells), dtype=np.int64)
    tags = [own]
    kinds = {"triangle": mesh.face_groups, "vertex": mesh.node_groups, "tetra": mesh.cell_groups}
    for kind, name, members in ((kind, *pair) for kind, groups in kinds.items() for pair in groups.items()):
        number = len(names) + 1
        if name in names or (kind == "tetra" and own[members].any()):
            why = "its name is taken by another group" if name in names else "it overlaps another cell group"
            lost.append(f'the {kind} group "{name}" is not kept: {why}')
            continue
        names[name] = np.array([number, LINEAR[kind][1]])
        if kind == "tetra":
            own[members] = number
        elif len(members):
            blocks.append((kind, members.reshape(len(members), -1)))
            tags.append(np.full(len(members), number, dtype=np.int64))
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    return meshio.Mesh(mesh.points, blocks, point_data, data, field_data=names), tuple(lost)
