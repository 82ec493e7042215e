"""The volume inside a surface, whatever state that is in: fTetWild (Hu et al. 2020) in a process of its own.

It takes what scans and CAD exports are: not convex, open, with cracks and crossing triangles. A crash, or a mesh that
takes for ever, is the other process's; this one says so.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .apart import run_apart
from .checks import Floats, Ints, MeshError, as_points, as_triangles, flipped, is_positive
from .tet import TetMesh

FINENESS = 12
"""Edges along the diagonal of the surface's box where no size is given."""
CLOSENESS = 0.1
"""How far off the surface its mesh may be, of the length of an edge."""
MISSING = "to fill a surface, install pytetwild: pip install 'jaxfem[mesh]'"
_PROGRAM = """
import sys
import numpy
try:
    import pytetwild
except ModuleNotFoundError as problem:
    if problem.name != "pytetwild":
        raise
    sys.exit("no pytetwild: " + str(problem))
given = numpy.load(sys.argv[1])
points, cells = pytetwild.tetrahedralize(
    given["points"],
    given["triangles"],
    edge_length_abs=float(given["size"]),
    epsilon=float(given["epsilon"]),
    quiet=True,
)[:2]
numpy.savez(sys.argv[2], points=points, cells=cells)
"""


def from_surface(
    points: Any,
    triangles: Any,
    size: float | None = None,
    name: str = "body",
    *,
    closeness: float | None = None,
    seconds: float = 300.0,
) -> TetMesh:
    """Tetrahedra with edges of about `size` [m] inside a surface: `points` (n, 3) [m] and `triangles` (k, 3).

    The surface may be open, not convex, cracked or crossing itself: what is inside is found by winding numbers. The
    mesh is within `closeness` [m] of it (a tenth of an edge without it); `notes` say how much volume that costs.
    Without `size` there are about twelve edges along the diagonal. MeshError where `pytetwild` is not installed, fails,
    finds no inside, or takes longer than `seconds`.
    """
    places = as_points(points, name)
    faces = as_triangles(triangles, len(places), name)
    diagonal = float(np.linalg.norm(np.ptp(places[np.unique(faces)], axis=0)))
    length = diagonal / FINENESS if size is None else size
    for what, value in (("size", length), ("closeness", closeness), ("seconds", seconds)):
        if value is not None and not is_positive(value):
            raise MeshError(f'{what} for "{name}" is {value!r}: give a positive number')
    share = (CLOSENESS * float(length) if closeness is None else closeness) / diagonal
    found, cells = _filled(places, faces, float(length), share, float(seconds), name)
    cells, _ = flipped(found, cells)  # the mesher counts corners the other way round
    mesh = TetMesh.repaired(found, cells, name)
    return TetMesh(mesh.points, mesh.cells, name, notes=(*mesh.notes, _told(mesh, places, faces, float(length))))


def _filled(points: Floats, triangles: Ints, size: float, share: float, seconds: float, name: str) -> tuple[Any, Any]:
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "given.npz", Path(folder) / "made.npz"
        np.savez(given, points=points, triangles=triangles.astype(np.int32), size=size, epsilon=share)
        said = run_apart(_PROGRAM, [given, made], made, seconds, f'filling "{name}" with edges of {size:.3g} m')
        if said is not None and "no pytetwild" in said:
            raise MeshError(f'"{name}" is a surface: {MISSING} ({said})')
        if said is not None:
            raise MeshError(f'filling "{name}" failed: {said}. Is it a surface around a volume, and the size sensible?')
        with np.load(made) as arrays:
            found = arrays["points"], arrays["cells"].astype(np.int64)
    if not len(found[1]):
        raise MeshError(f'"{name}" has no inside to fill: its triangles lie flat, or face no way around a volume')
    return found


def _told(mesh: TetMesh, points: Floats, triangles: Ints, size: float) -> str:
    """What was made of the surface, in words."""
    corners = points[triangles]
    volume = abs(float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6))
    compared = (
        f", {round(100 * (mesh.volume / volume - 1), 1) + 0.0:+.1f} % of the surface's" if _closed(triangles) else ""
    )
    state = "" if _closed(triangles) else ", which is not closed,"
    return (
        f"a surface of {len(triangles)} triangles{state} was filled with {len(mesh.cells)} elements of about "
        f"{size:.3g} m; volume {mesh.volume:.4g} m^3{compared}"
    )


def _closed(triangles: Ints) -> bool:
    """Whether each edge is run once in each direction."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)
    return bool(np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0)))
