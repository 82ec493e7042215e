"""VTK's XML files of unstructured grids (.vtu), all versions: text, base64 or raw, appended, compressed, in pieces.

The format: VTK File Formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

import base64
import lzma
import re
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import MeshError
from ..raw import RawMesh
from .foreign import TAGS
from .lz4 import unpack_lz4
from .vtk_cells import mesh_of

APPENDED = re.compile(rb"<AppendedData([^>]*)>\s*_", re.DOTALL)


def read_vtu(path: Path) -> RawMesh:
    """The cells of all pieces; of the values only numbers of groups are read."""
    content = path.read_bytes()
    found = APPENDED.search(content)
    appended, in_text = b"", False
    if found:
        end = content.rfind(b"</AppendedData>")
        appended, in_text = content[found.end() : end], b"base64" in found[1]
        content = content[: found.start()] + content[end + len(b"</AppendedData>") :]
    root = ET.fromstring(content)
    if root.get("type") != "UnstructuredGrid":
        raise MeshError(f"it holds a {root.get('type')}, not an UnstructuredGrid: save it as one (.vtu)")
    arrays = _Arrays(root, appended.strip() if in_text else appended, in_text)
    pieces = [_piece(piece, arrays) for piece in root.iter("Piece") if int(piece.get("NumberOfPoints", 1))]
    if not pieces:
        raise MeshError("it holds no piece with points")
    points, types, nodes, offsets, tags = zip(*pieces, strict=True)
    shifts = np.cumsum([0] + [len(each) for each in points])
    ends = np.cumsum([0] + [len(each) for each in nodes])
    return mesh_of(
        np.concatenate(points),
        np.concatenate(types),
        np.concatenate([each + shift for each, shift in zip(nodes, shifts, strict=False)]),
        np.concatenate([[0], *(each + end for each, end in zip(offsets, ends, strict=False))]),
        None if any(each is None for each in tags) else np.concatenate(tags),
    )


def _piece(piece: Any, arrays: "_Arrays") -> tuple[Any, Any, Any, Any, Any]:
    """Points, types, nodes, ends and numbers of groups (or None) of the cells of one piece."""
    cells = {each.get("Name"): each for each in piece.findall("./Cells/DataArray")}
    places = piece.find("./Points/DataArray")
    if places is None or not {"connectivity", "offsets", "types"} <= set(cells):
        raise MeshError("a piece of it lacks points or cells")
    points = arrays.values(places).reshape(-1, int(places.get("NumberOfComponents", 3)))
    read = [arrays.values(cells[name]).astype(np.int64) for name in ("types", "connectivity", "offsets")]
    values = {each.get("Name"): each for each in piece.findall("./CellData/DataArray")}
    key = next((key for key in TAGS if key in values), None)
    return points, *read, None if key is None else arrays.values(values[key]).astype(np.int64)


class _Arrays:
    """Reads the DataArrays of one file, whose root says byte order, type of headers and compression."""

    def __init__(self, root: Any, appended: bytes, in_text: bool):
        self.order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
        self.header = np.dtype(self.order + ("u8" if root.get("header_type") == "UInt64" else "u4"))
        self.appended, self.in_text = appended, in_text
        self.unpack = _unpacker(root.get("compressor"))

    def values(self, array: Any) -> Any:
        """The numbers of one DataArray element, flat."""
        kind, bits = re.fullmatch(r"(Float|Int|UInt)(\d+)", array.get("type", "")).groups()  # type: ignore[union-attr]
        dtype = np.dtype(f"{self.order}{ {'Float': 'f', 'Int': 'i', 'UInt': 'u'}[kind] }{int(bits) // 8}")
        encoding, text = array.get("format", "ascii"), (array.text or "")
        if encoding == "ascii":
            return np.array(text.split(), dtype=np.float64 if kind == "Float" else np.int64)
        if encoding == "appended":
            data = self.appended[int(array.get("offset", 0)) :]
            packed = self._from_text(data) if self.in_text else self._from_bytes(data)
        else:
            packed = self._from_text("".join(text.split()).encode())
        return np.frombuffer(packed, dtype)

    def _from_bytes(self, data: bytes) -> bytes:
        width = self.header.itemsize
        if self.unpack is None:
            return data[width : width + self._heads(data, 1)[0]]
        count = self._heads(data, 1)[0]
        sizes = self._heads(data, 3 + count)[3:]
        return self._blocks(data[(3 + count) * width :], sizes)

    def _from_text(self, data: bytes) -> bytes:
        width = self.header.itemsize
        if self.unpack is None:
            length = _letters(width)
            if data[length - 1 : length] == b"=":  # the header on its own, as some writers do
                count = self._heads(base64.b64decode(data[:length]), 1)[0]
                return base64.b64decode(data[length : length + _letters(count)])[:count]
            count = self._heads(base64.b64decode(data[: _letters(3 * -(-width // 3))]), 1)[0]
            return base64.b64decode(data[: _letters(width + count)])[width : width + count]
        count = self._heads(base64.b64decode(data[: _letters(3 * -(-width // 3))]), 1)[0]
        length = _letters((3 + count) * width)
        sizes = self._heads(base64.b64decode(data[:length]), 3 + count)[3:]
        return self._blocks(base64.b64decode(data[length : length + _letters(sum(sizes))]), sizes)

    def _heads(self, data: bytes, count: int) -> list[int]:
        heads: list[int] = np.frombuffer(data, self.header, count).tolist()
        return heads

    def _blocks(self, data: bytes, sizes: list[int]) -> bytes:
        assert self.unpack is not None
        starts = np.cumsum([0, *sizes]).tolist()
        return b"".join(self.unpack(data[a : a + size]) for a, size in zip(starts, sizes, strict=False))


def _letters(count: int) -> int:
    """How many letters of base64 hold `count` bytes."""
    return 4 * -(-count // 3)


def _unpacker(compressor: str | None) -> Callable[[bytes], bytes] | None:
    if compressor in (None, ""):
        return None
    if compressor == "vtkZLibDataCompressor":
        return zlib.decompress
    if compressor == "vtkLZMADataCompressor":
        return lzma.decompress
    if compressor == "vtkLZ4DataCompressor":
        return unpack_lz4
    raise MeshError(f"it is compressed by {compressor}, which cannot be read here: save it with ZLib, or uncompressed")
