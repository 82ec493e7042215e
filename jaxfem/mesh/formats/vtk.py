"""VTK's legacy files (.vtk): unstructured grids, and surfaces as polydata, as text or binary, versions 1 to 5.

The format: VTK File Formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import MeshError
from ..raw import RawMesh
from .foreign import read_foreign
from .vtk_cells import mesh_of

WIDTHS = {  # names of types -> those of NumPy, big-endian in binary files
    **{"float": ">f4", "double": ">f8", "int": ">i4", "unsigned_int": ">u4", "long": ">i8", "unsigned_long": ">u8"},
    **{"vtktypeint64": ">i8", "vtktypeint32": ">i4", "vtkidtype": ">i8", "short": ">i2", "unsigned_short": ">u2"},
    **{"char": ">i1", "unsigned_char": ">u1"},
}
FLAT = {"VERTICES": 2, "LINES": 4, "POLYGONS": 7, "TRIANGLE_STRIPS": 6}  # of polydata: the VTK types they stand for


def read_vtk(path: Path) -> RawMesh:
    """The cells of the file; values on them are not read. Structured grids go through meshio."""
    content = path.read_bytes()
    head = content.split(b"\n", 3)
    if len(head) < 4 or not head[0].startswith(b"# vtk DataFile"):
        raise MeshError("it does not start as a VTK file does")
    scan: _Text | _Binary = _Binary(head[3]) if head[2].strip().upper() == b"BINARY" else _Text(head[3])
    if scan.word().upper() != "DATASET":
        raise MeshError("it names no DATASET")
    dataset = scan.word().upper()
    if dataset not in ("UNSTRUCTURED_GRID", "POLYDATA"):
        return read_foreign(path)
    points, types, lists = _parts(scan)
    if points is None:
        raise MeshError("it holds no POINTS")
    if dataset == "UNSTRUCTURED_GRID" and (types is None or "CELLS" not in lists):
        raise MeshError("it holds no CELLS with CELL_TYPES")
    if types is None:
        lists = {name: each for name, each in lists.items() if name in FLAT}
        types = np.concatenate([[], *(_types(name, offsets) for name, (_, offsets) in lists.items())])
    nodes = np.concatenate([[], *(nodes for nodes, _ in lists.values())])
    starts = np.cumsum([0, *(len(nodes) for nodes, _ in lists.values())])
    ends = [offsets[1:] + start for (_, offsets), start in zip(lists.values(), starts, strict=False)]
    return mesh_of(points, types, nodes, np.concatenate([[0], *ends]))


def _types(name: str, offsets: Any) -> Any:
    """VTK types of polydata's cells: polygons of three and four corners are triangles and quadrilaterals."""
    sizes = np.diff(offsets)
    return np.where((name == "POLYGONS") & (sizes <= 4), np.where(sizes == 3, 5, 9), FLAT[name])


def _parts(scan: "_Text | _Binary") -> tuple[Any, Any, dict[str, tuple[Any, Any]]]:
    """Points (n, 3), types, and name -> (nodes, offsets) of the lists of cells; data after them is not read."""
    points, types, lists = None, None, {}
    while word := scan.word().upper():
        if word == "POINTS":
            count, kind = int(scan.word()), scan.word()
            points = scan.numbers(3 * count, kind).astype(np.float64).reshape(-1, 3)
        elif word == "CELL_TYPES":
            types = scan.numbers(int(scan.word()), "int").astype(np.int64)
        elif word in FLAT or word == "CELLS":
            lists[word] = _cells(scan, int(scan.word()), int(scan.word()))
        elif word == "FIELD":
            scan.word()
            for _ in range(int(scan.word())):
                _, width, length, kind = scan.word(), int(scan.word()), int(scan.word()), scan.word()
                scan.numbers(width * length, kind)
        elif word in ("CELL_DATA", "POINT_DATA"):
            break
        else:
            raise MeshError(f"{word[:40]!r} stands where a part of it should begin")
    return points, types, lists


def _cells(scan: "_Text | _Binary", first: int, second: int) -> tuple[Any, Any]:
    """Nodes and offsets of a list of cells: counts among the nodes (to version 4), or two lists (5)."""
    if scan.next_is("OFFSETS"):
        offsets = scan.numbers(first, scan.word()).astype(np.int64)
        if scan.word().upper() != "CONNECTIVITY":
            raise MeshError("its OFFSETS are not followed by CONNECTIVITY")
        return scan.numbers(second, scan.word()).astype(np.int64), offsets
    values = scan.numbers(second, "int").astype(np.int64)
    starts, place = np.zeros(first + 1, np.int64), 0
    for number in range(first):
        starts[number] = place
        place += int(values[place]) + 1
    starts[first] = place
    keep = np.ones(len(values), bool)
    keep[starts[:-1]] = False
    return values[keep], starts - np.arange(first + 1)


class _Text:
    """Words and numbers of a text file."""

    def __init__(self, content: bytes):
        self.words, self.at = re.sub(rb"\nMETADATA.*?(\n[ \t\r]*\n|\Z)", b"\n", content, flags=re.DOTALL).split(), 0

    def word(self) -> str:
        """The next word, "" at the end."""
        self.at += 1
        return self.words[self.at - 1].decode(errors="replace") if self.at <= len(self.words) else ""

    def next_is(self, word: str) -> bool:
        """Whether the next word is this one, which is taken then."""
        here = self.words[self.at : self.at + 1] == [word.encode()]
        self.at += here
        return here

    def numbers(self, count: int, kind: str) -> Any:
        """So many numbers of a type."""
        words = self.words[self.at : self.at + count]
        if len(words) < count:
            raise MeshError(f"{count} numbers are announced where {len(words)} follow: the file is cut short")
        self.at += count
        return np.array(words, dtype=np.float64 if WIDTHS.get(kind.lower(), ">f8")[1] == "f" else np.int64)


class _Binary:
    """Words and numbers of a binary file, from `place` on."""

    def __init__(self, content: bytes):
        self.content, self.place = content, 0

    def word(self) -> str:
        """The next word, "" at the end; what is said about arrays (METADATA, up to an empty line) is passed over."""
        found = re.compile(rb"\s*(METADATA.*?(?:\n[ \t\r]*\n|\Z)\s*)?(\S*)", re.DOTALL).match(self.content, self.place)
        assert found is not None
        self.place = found.end()
        return found[2].decode(errors="replace")

    def next_is(self, word: str) -> bool:
        """Whether the next word is this one, which is taken then."""
        found = re.compile(rb"\s*" + word.encode() + rb"\s").match(self.content, self.place)
        self.place = found.end() - 1 if found else self.place
        return found is not None

    def numbers(self, count: int, kind: str) -> Any:
        """So many numbers of a type, which start on the next line."""
        if kind.lower() not in WIDTHS:
            raise MeshError(f"numbers of type {kind!r} cannot be read")
        dtype = np.dtype(WIDTHS[kind.lower()])
        start = self.content.index(b"\n", self.place) + 1
        if start + count * dtype.itemsize > len(self.content):
            raise MeshError(f"{count} numbers are announced, which do not follow: the file is cut short")
        self.place = start + count * dtype.itemsize
        return np.frombuffer(self.content, dtype, count, start)
