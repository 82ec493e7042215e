"""Tetrahedra in CAD models by Gmsh (Geuzaine & Remacle 2009), where its package is installed; in a process of its own.

Gmsh keeps one state for a whole process and may crash or take for ever on a broken model: that is the other process's.
"""

import tempfile
from pathlib import Path
from typing import Any

from .apart import run_apart
from .checks import MeshError, is_positive
from .files import read
from .tet import TetMesh

SUFFIXES = (".step", ".stp", ".iges", ".igs")  # .brep does not say its unit
MISSING = "to mesh CAD models, install Gmsh: pip install 'jaxfem[cad]'"
_PROGRAM = """
import os
import sys
try:
    import gmsh
except (ImportError, OSError) as problem:  # its library needs some of the system's
    sys.exit("no gmsh: " + str(problem))
source, target = sys.argv[1:3]
size, finest = map(float, sys.argv[3:])
gmsh.initialize()
for option, value in (("General.Terminal", 0), ("Mesh.Algorithm3D", 10), ("Mesh.Binary", 1)):
    gmsh.option.setNumber(option, value)
gmsh.option.setString("Geometry.OCCTargetUnit", "M")
gmsh.model.occ.importShapes(source)
volumes = gmsh.model.occ.getEntities(3)
if len(volumes) > 1:  # parts that touch share their nodes
    gmsh.model.occ.fragment(volumes[:1], volumes[1:])
gmsh.model.occ.synchronize()
if not gmsh.model.getEntities(3):
    sys.exit("no volume")
for dimension, word in ((2, "surface"), (3, "volume")):
    named = {}
    for _, tag in gmsh.model.getEntities(dimension):
        label = gmsh.model.getEntityName(dimension, tag).split("/")[-1].strip()
        if label.startswith("Open CASCADE"):  # what its writer calls all that has no name
            label = ""
        named.setdefault(label or word + " " + str(tag), []).append(tag)
    for label, tags in named.items():
        gmsh.model.addPhysicalGroup(dimension, tags, name=label)
low_high = gmsh.model.getBoundingBox(-1, -1)
diagonal = sum((b - a) ** 2 for a, b in zip(low_high[:3], low_high[3:])) ** 0.5
size = size or diagonal / 12
if finest > size:
    sys.exit("finest is more than the size of " + format(size, ".3g") + " m")
gmsh.option.setNumber("Mesh.MeshSizeMax", size)
gmsh.option.setNumber("Mesh.MeshSizeMin", finest or size)
if finest:
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 12)
gmsh.model.mesh.generate(3)
gmsh.model.mesh.optimize("Netgen")
gmsh.write(target)
gmsh.finalize()
"""


def from_cad(
    path: Any,
    size: float | None = None,
    name: str | None = None,
    *,
    finest: float | None = None,
    seconds: float = 300.0,
) -> TetMesh:
    """Tetrahedra with edges of at most `size` [m] in the volumes of a CAD model (.step, .iges).

    With `finest` [m] the mesh is graded: twelve edges around a full turn of what is curved, none shorter than that.
    Without `size` there are about twelve edges along the diagonal. The file's unit is known and taken to m. Surfaces
    and volumes are groups by their labels in the file, else "surface 1", "volume 1" and so on; volumes that touch share
    nodes. MeshError where `gmsh` is not installed, fails, finds no volume, or takes longer than `seconds`.
    """
    source = Path(path)
    label = source.stem if name is None else name
    if source.suffix.lower() not in SUFFIXES:
        raise MeshError(f"{source} is no CAD model: give one of {', '.join(SUFFIXES)}")
    if not source.is_file():
        raise MeshError(f"there is no file {source}")
    for what, value in (("size", size), ("finest", finest), ("seconds", seconds)):
        if value is not None and not is_positive(value):
            raise MeshError(f'{what} for "{label}" is {value!r}: give a positive number')
    if size is not None and finest is not None and finest > size:
        raise MeshError(f'finest for "{label}" is {finest:g} m, more than its size, {size:g} m')
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made.msh"
        _run(source, made, (size or 0.0, finest or 0.0), float(seconds), label)
        mesh = read(made, scale=1.0)
    told = f"{source.name} was filled with {len(mesh.cells)} elements; volume {mesh.volume:.4g} m^3"
    return TetMesh(
        mesh.points, mesh.cells, label, mesh.face_groups, mesh.node_groups, mesh.cell_groups, (*mesh.notes, told)
    )


def _run(source: Path, made: Path, sizes: tuple[float, float], seconds: float, label: str) -> None:
    words = [source.resolve(), made, *map(float, sizes)]
    said = run_apart(_PROGRAM, words, made, seconds, f'meshing "{label}"')
    if said is None:
        return
    if "no gmsh" in said:
        raise MeshError(f'"{label}" is a CAD model: {MISSING} ({said})')
    if said == "no volume":
        raise MeshError(f'"{label}" holds no volume to mesh: export it as a solid, or fill its surface (from_surface)')
    raise MeshError(f'meshing "{label}" failed: {said}. Is it a valid solid, and the size sensible?')
