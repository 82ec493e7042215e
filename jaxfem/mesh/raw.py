"""What any mesh file holds, before it is sorted out: points, blocks of cells of one kind, sets. The readers make it."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .checks import Floats, Ints, MeshError

CORNERS = {  # shape of a cell -> how many of its nodes are corners, and its dimension
    "tetra": (4, 3),
    "hexahedron": (8, 3),
    "wedge": (6, 3),
    "pyramid": (5, 3),
    "triangle": (3, 2),
    "quad": (4, 2),
    "line": (2, 1),
    "vertex": (1, 0),
}
Members = list[tuple[int, Ints]]  # of a set: number of a block, numbers of cells in it


@dataclasses.dataclass
class RawMesh:
    """Points (n, 3), blocks of cells of one kind each, and sets, in the numbering of the file.

    A kind is a shape and its number of nodes, like "hexahedron20" ("tetra", "hexahedron" and so on alone are linear);
    a cell's corners come first, in the order of Abaqus and Gmsh. `cell_sets`: name -> members; `node_sets`: name ->
    numbers; `face_sets`: name -> arrays (k, 3) or (k, 4) of node numbers; `left_out`: kind -> how many cells the reader
    had no use for.
    """

    points: Floats
    blocks: list[tuple[str, Ints]]
    cell_sets: dict[str, Members] = dataclasses.field(default_factory=dict)
    node_sets: dict[str, Ints] = dataclasses.field(default_factory=dict)
    face_sets: dict[str, list[Ints]] = dataclasses.field(default_factory=dict)
    left_out: dict[str, int] = dataclasses.field(default_factory=dict)
    notes: list[str] = dataclasses.field(default_factory=list)

    def checked(self, source: str) -> "RawMesh":
        """The same with points (n, 3) and blocks of integers; MeshError when a cell uses a point that is not there."""
        points = solid_points(self.points)
        blocks = [(kind, np.asarray(rows, dtype=np.int64)) for kind, rows in self.blocks if len(rows)]
        for kind, rows in blocks:
            if rows.min() < 0 or rows.max() >= len(points):
                bad = int(np.flatnonzero(((rows < 0) | (rows >= len(points))).any(axis=1))[0])
                raise MeshError(
                    f"{kind} {bad} of {source} uses a node that does not exist: there are {len(points)}, "
                    "is the file complete?"
                )
        numbers = np.cumsum([len(rows) > 0 for _, rows in self.blocks]) - 1
        sets = {
            name: [(int(numbers[block]), chosen) for block, chosen in members if len(chosen)]
            for name, members in self.cell_sets.items()
        }
        return dataclasses.replace(self, points=points, blocks=blocks, cell_sets=sets)


def shape_of(kind: str) -> str | None:
    """The shape of a kind of cell, or None where it is none that is known: "hexahedron20" is a "hexahedron"."""
    found = re.fullmatch(r"([a-z]+?)(\d*)", kind)
    return found[1] if found and found[1] in CORNERS else None


def dimension(kind: str) -> int | None:
    """3 for solids, 2 for surfaces, 1 for lines, 0 for points; None for unknown kinds."""
    shape = shape_of(kind)
    return None if shape is None else CORNERS[shape][1]


def solid_points(points: Any) -> Floats:
    """Points as (n, 3): a plane file's get z = 0."""
    array = np.asarray(points, dtype=np.float64)
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1]))) if array.ndim == 2 and array.shape[1] < 3 else array


def sets_of_tags(
    blocks: Sequence[tuple[str, Any]], tags: Sequence[Any], names: Mapping[tuple[int, int], str]
) -> dict[str, Members]:
    """Cell sets from one number a cell (blocks' arrays in `tags`); 0 is no set.

    A set's name is that of (dimension, number), or else the number. One nameless number on all solids, or any on lines
    and points, says nothing and makes no set.
    """
    sets: dict[str, Members] = {}
    for dim in range(4):
        own = [
            (i, np.asarray(each).reshape(-1).astype(np.int64))
            for i, each in enumerate(tags)
            if dimension(blocks[i][0]) == dim
        ]
        values = np.unique(np.concatenate([np.zeros(0, np.int64), *(each for _, each in own)]))
        values = values[values != 0]
        named = any(key[0] == dim for key in names)
        if dim != 2 and not named and (dim < 2 or len(values) < 2):
            continue
        for value in values.tolist():
            chosen = [(i, np.flatnonzero(each == value)) for i, each in own]
            name = names.get((dim, value), str(value))
            sets.setdefault(name, []).extend((i, numbers) for i, numbers in chosen if len(numbers))
    return sets
