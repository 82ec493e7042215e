"""Mesh files: what a reader finds, sorted out and checked; what is lost or changed on the way is said."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .blocks import sort_out, surface_of
from .checks import Floats, Ints, MeshError, MeshWarning, is_positive
from .formats import READERS
from .formats.foreign import endings, quietly, read_foreign, write_foreign
from .raw import CORNERS, RawMesh
from .seams import merge_distance, merged
from .tet import TetMesh
from .units import doubt

StrPath = str | os.PathLike[str]


def read(path: StrPath, scale: float | None = None, name: str | None = None, *, merge: bool | float = False) -> TetMesh:
    """The volume of a mesh file (.msh, .vtu, .vtk, .node or .ele, .inp, .mesh, ...), lengths times `scale`.

    scale=1e-3 reads a file in millimetres; without a scale lengths are taken as m, and a size that is unlikely in m is
    asked about. name is the file's stem by default. Hexahedra, wedges and pyramids are cut into tetrahedra that fit
    together. Named or numbered physical groups, sets, surfaces and markers become face, node and cell groups.
    `merge=True` makes nodes one that lie on top of another, a number those at most so far apart [m]. Everything left
    out, cut, made linear or repaired stands in the mesh's `notes`, of which `build` warns. FileNotFoundError for a
    missing file; MeshError for a file that is of no known format, cannot be read, holds no volume, or holds cells that
    cannot be made tetrahedra.
    """
    source = _existing(path, scale)
    label = source.stem if name is None else name
    distance = merge_distance(merge, str(path))
    raw = _raw(source)
    raw.points = raw.points * (1.0 if scale is None else scale)
    if distance is not None:
        raw = merged(raw, distance)
    parts = sort_out(raw, str(source))
    used = parts.points[parts.cells.reshape(-1)]
    question = doubt(np.ptp(used, axis=0), label) if scale is None else None
    notes = parts.notes if question is None else (question, *parts.notes)
    return TetMesh.repaired(
        parts.points, parts.cells, label, parts.face_groups, parts.node_groups, parts.cell_groups, notes
    )


def from_cells(points: Any, cells: Mapping[str, Any], name: str = "mesh", *, merge: bool | float = False) -> TetMesh:
    """A mesh of points (n, 3) [m] and cells of any shapes: "tetra" (m, 4), "hexahedron" (m, 8), "wedge" (m, 6),
    "pyramid" (m, 5), or these with mid-side nodes after the corners, like "hexahedron20" (m, 20).

    Corners are in the order of Abaqus, Gmsh and VTK. They are cut into tetrahedra as `read` does, which `notes` tell;
    `merge` as there. MeshError for unknown shapes and for what `read` refuses.
    """
    blocks = []
    for kind, rows in cells.items():
        array = np.asarray(rows)
        shape = kind.rstrip("0123456789")
        if shape not in CORNERS or array.ndim != 2 or array.shape[1] < CORNERS[shape][0]:
            known = ", ".join(f'"{each}" (m, {corners})' for each, (corners, _) in CORNERS.items())
            raise MeshError(f'cells "{kind}" of "{name}" have shape {array.shape}: give some of {known}')
        blocks.append((shape if array.shape[1] == CORNERS[shape][0] else f"{shape}{array.shape[1]}", array))
    raw = RawMesh(points, blocks).checked(f'"{name}"')
    distance = merge_distance(merge, f'"{name}"')
    parts = sort_out(raw if distance is None else merged(raw, distance), f'"{name}"')
    return TetMesh.repaired(parts.points, parts.cells, name, notes=parts.notes)


def read_surface(path: StrPath, scale: float | None = None) -> tuple[Floats, Ints]:
    """Points (n, 3) and triangles (k, 3) of a surface file (.obj, .stl, .ply, .off, ...); quads are cut in two.

    Points at the same place are merged, as .stl files need. Lengths are multiplied by `scale`; without one they are
    taken as m, and a MeshWarning asks about a size that is unlikely in m. FileNotFoundError and MeshError as for
    `read`; MeshError too for a file without triangles.
    """
    source = _existing(path, scale)
    raw = _raw(source)
    triangles = surface_of(raw)
    if not len(triangles):
        raise MeshError(f"no triangles in {source}: found {', '.join(kind for kind, _ in raw.blocks) or 'no cells'}")
    places, merged_into = np.unique(raw.points, axis=0, return_inverse=True)
    used, numbers = np.unique(merged_into.reshape(-1)[triangles], return_inverse=True)
    question = doubt(np.ptp(places[used], axis=0), source.name) if scale is None else None
    if question is not None:
        warnings.warn(question, MeshWarning, stacklevel=2)
    return places[used] * (1.0 if scale is None else scale), numbers.reshape(-1, 3).astype(np.int64)


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
    target = Path(path)
    ending = _ending(target)
    points = _checked(point_data, len(mesh.points), "point", "nodes")
    cells = _checked(cell_data, len(mesh.cells), "cell", "elements")
    tets = [("tetra", mesh.cells)]
    if ending in (".node", ".ele"):
        lost = _lost(mesh, ending) + (("TetGen files keep no data on nodes or elements",) if points or cells else ())
        quietly(lambda: write_foreign(target, mesh.points, tets), "write", target)
        return lost
    if ending == ".msh":
        blocks, data, names, lost = _with_groups(mesh)
        quietly(
            lambda: write_foreign(target, mesh.points, blocks, points, data, names, file_format="gmsh22"),
            "write",
            target,
        )
        # meshio cannot read back data on several blocks of cells
        return lost + ((f"cell data {', '.join(cells)} is not kept in .msh files: write .vtu",) if cells else ())
    options: dict[str, Any] = (
        {"data_format": "XML"} if ending in (".xdmf", ".xmf") else {}
    )  # one file, and no need for HDF5
    each = {key: [values] for key, values in cells.items()}
    quietly(lambda: write_foreign(target, mesh.points, tets, points, each, **options), "write", target)
    return _lost(mesh, ending)


def _existing(path: StrPath, scale: float | None) -> Path:
    """The path, if there is such a file of a known kind and the scale is usable."""
    if scale is not None and not is_positive(scale):
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
    return sorted({*endings(), *READERS})


def _ending(path: Path) -> str:
    """The file's ending in lower case; MeshError when no format has it."""
    for ending in (path.suffix.lower(), "".join(path.suffixes[-2:]).lower()):
        if ending in _known():
            return ending
    raise MeshError(f'{path} has the ending "{path.suffix}", of no known mesh format: known are {" ".join(_known())}')


def _raw(source: Path) -> RawMesh:
    reader = READERS.get(source.suffix.lower(), read_foreign)

    def found() -> RawMesh:
        return reader(source).checked(source.name)

    raw: RawMesh = quietly(found, "read", source)
    return raw


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


def _with_groups(
    mesh: TetMesh,
) -> tuple[list[tuple[str, Ints]], dict[str, list[Ints]], dict[str, Ints], tuple[str, ...]]:
    """Blocks, their data and names of physical groups: face groups (triangles), node groups (vertices) and cell groups;
    and what could not be kept."""
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
        names[name] = np.array([number, CORNERS[kind][1]])
        if kind == "tetra":
            own[members] = number
        elif len(members):
            blocks.append((kind, members.reshape(len(members), -1)))
            tags.append(np.full(len(members), number, dtype=np.int64))
    return blocks, {"gmsh:physical": tags, "gmsh:geometrical": tags}, names, tuple(lost)
