"""TetGen's text files: .node and .ele, and .face where there is one."""

from pathlib import Path

import numpy as np

from ..checks import Floats, Ints, MeshError
from ..raw import RawMesh, sets_of_tags


def read_tetgen(path: Path) -> RawMesh:
    """The mesh of NAME.node and NAME.ele, whichever is given, with boundary markers from NAME.face.

    Markers and regions become sets. FileNotFoundError when one of the two is missing.
    """
    node_file, element_file, face_file = (path.with_suffix(suffix) for suffix in (".node", ".ele", ".face"))
    for needed in (node_file, element_file):
        if not needed.exists():
            raise FileNotFoundError(f"{path} needs {needed.name} beside it: TetGen keeps nodes and elements apart")
    header, nodes = _table(node_file)
    if header[1] != 3:
        raise MeshError(f"{node_file} holds points in {header[1]} dimensions: three are needed")
    base = int(nodes[0, 0])
    if (nodes[:, 0] != base + np.arange(len(nodes))).any():
        raise MeshError(f"{node_file} does not number its nodes one after the other: let TetGen write it anew")
    header, rows = _table(element_file)
    corners = header[1]
    if corners not in (4, 10):
        raise MeshError(f"{element_file} has elements of {corners} nodes: tetrahedra have 4 or 10")
    blocks = [("tetra" if corners == 4 else "tetra10", rows[:, 1 : 1 + corners].astype(np.int64) - base)]
    refs = [_column(rows, 1 + corners)]
    if face_file.exists():
        _, faces = _table(face_file)
        if len(faces):
            blocks.append(("triangle", faces[:, 1:4].astype(np.int64) - base))
            refs.append(_column(faces, 4))
    return RawMesh(nodes[:, 1:4], blocks, sets_of_tags(blocks, refs, {}))


def _column(rows: Floats, number: int) -> Ints:
    """A column of whole numbers, zeros where the file has none."""
    return rows[:, number].astype(np.int64) if rows.shape[1] > number else np.zeros(len(rows), dtype=np.int64)


def _table(path: Path) -> tuple[list[int], Floats]:
    """The header's numbers and the rows after it; comments start with #."""
    lines = [line.partition("#")[0].strip() for line in path.read_text(errors="replace").splitlines()]
    lines = [line for line in lines if line]
    try:
        header = [int(word) for word in lines[0].split()]
        rows = np.array([[float(word) for word in line.split()] for line in lines[1 : 1 + header[0]]], dtype=np.float64)
    except (IndexError, ValueError) as problem:
        raise MeshError(f"{path} is no TetGen file: {problem}") from problem
    if rows.ndim != 2 or len(rows) != header[0]:
        raise MeshError(f"{path} promises {header[0]} rows and holds {len(rows)}: the file is cut short")
    return header, rows
