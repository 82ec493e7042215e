"""VTK's cell types: lists of cells of mixed types, as its files hold them, made blocks of one kind."""

from collections.abc import Sequence

import numpy as np

from ..checks import Ints, MeshError
from ..raw import CORNERS, RawMesh, sets_of_tags

TYPES = {  # vtkCellType.h: number -> shape, corners first
    1: "vertex",
    3: "line",
    5: "triangle",
    9: "quad",
    10: "tetra",
    12: "hexahedron",
    13: "wedge",
    14: "pyramid",
    **{21: "line", 35: "line", 22: "triangle", 34: "triangle", 23: "quad", 28: "quad", 30: "quad"},
    **{24: "tetra", 25: "hexahedron", 29: "hexahedron", 33: "hexahedron", 26: "wedge", 31: "wedge", 32: "wedge"},
    **{27: "pyramid", 37: "pyramid"},
    **dict(zip(range(60, 68), "line triangle quad polygon tetra wedge pyramid hexahedron".split(), strict=True)),
    **dict(zip(range(68, 75), "line triangle quad tetra hexahedron wedge pyramid".split(), strict=True)),
    **dict(zip(range(75, 82), "line triangle quad tetra hexahedron wedge pyramid".split(), strict=True)),
}
OTHERS = {2: "polyvertex", 4: "polyline", 6: "strip", 7: "polygon", 0: "empty"}
OTHERS |= {15: "pentagonal prism", 16: "hexagonal prism", 41: "polyhedron", 42: "polyhedron"}
GRID_ORDER = {8: ("quad", [0, 1, 3, 2]), 11: ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6])}  # pixels and voxels


def mesh_of(
    points: Ints, types: Ints, connectivity: Ints, offsets: Ints, tags: Sequence[int] | Ints | None = None
) -> RawMesh:
    """Cells i with nodes connectivity[offsets[i] : offsets[i + 1]]; cells of one type and size become a block.

    `tags`: one number a cell, which makes sets.
    """
    types, offsets = np.asarray(types, np.int64), np.asarray(offsets, np.int64)
    connectivity = np.asarray(connectivity, np.int64)
    if len(offsets) != len(types) + 1 or (len(offsets) and offsets[-1] > len(connectivity)):
        raise MeshError("its lists of cells do not fit together: the file is cut short")
    sizes = np.diff(offsets)
    raw, numbers = RawMesh(np.asarray(points, np.float64), []), []
    pairs, first = np.unique(np.stack([types, sizes]), axis=1, return_index=True)
    for kind, size in pairs.T[np.argsort(first)].tolist():  # in the order of the file
        chosen = np.flatnonzero((types == kind) & (sizes == size))
        if kind in OTHERS or (kind not in TYPES and kind not in GRID_ORDER):
            name = OTHERS.get(kind, f"cell of VTK type {kind}")
            if kind in (0, 2, 4, 6, 7):
                raw.left_out[name] = raw.left_out.get(name, 0) + len(chosen)
                continue
            shape, order = name, list(range(size))
        else:
            shape, order = GRID_ORDER.get(kind) or (TYPES[kind], list(range(size)))
        if size < CORNERS.get(shape, (0, 0))[0]:
            raise MeshError(f"cell {chosen[0]}, a {shape}, has {size} nodes only: the file is cut short")
        rows = connectivity[offsets[chosen][:, None] + np.array(order)]
        raw.blocks.append((shape if size == CORNERS.get(shape, (size, 0))[0] else f"{shape}{size}", rows))
        numbers.append(chosen)
    if tags is not None:
        raw.cell_sets = sets_of_tags(raw.blocks, [np.asarray(tags)[chosen] for chosen in numbers], {})
    return raw
