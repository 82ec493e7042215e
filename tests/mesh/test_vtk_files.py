"""VTK's files: .vtu of all versions and encodings, legacy .vtk, with cells of several kinds."""

import base64
import itertools
import lzma
import zlib

import meshio
import numpy as np
import pytest

from jaxfem.mesh import MeshError, read, read_surface

CUBE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
POINTS = np.concatenate([CUBE, [[0.5, 0.5, 2], [2, 0, 0], [2, 0, 1], [-1, 0.5, 0.5]]])
# A brick, a pyramid on it, a wedge beside it in VTK's order, a tetrahedron, a line and a triangle: out of order
CELLS = [(12, [0, 1, 2, 3, 4, 5, 6, 7]), (3, [0, 1]), (10, [0, 4, 3, 11]), (13, [1, 2, 9, 5, 6, 10])]
CELLS += [(14, [4, 5, 6, 7, 8]), (5, [0, 1, 2])]
VOLUME = 1 + 1 / 3 + 1 / 2 + 1 / 6


def arrays(cells=CELLS):
    nodes = np.array([n for _, own in cells for n in own])
    ends = np.cumsum([len(own) for _, own in cells])
    return nodes, ends, np.array([kind for kind, _ in cells])


def lz4(data):
    """A block with one repetition, of what the last four bytes before the tail would be anyway, where there is one."""
    for at in range(1, len(data) - 12):
        run = next((n for n in range(len(data) - 5 - at) if data[at + n] != data[at + n - 1]), len(data) - 5 - at)
        if run >= 4:
            extra = run - 4
            head = bytes([(min(at, 15) << 4) | min(extra, 15)]) + (bytes([at - 15]) if at >= 15 else b"")
            tail = data[at + run :]
            long = bytes([extra - 15]) if extra >= 15 else b""
            rest = bytes([min(len(tail), 15) << 4]) + (bytes([len(tail) - 15]) if len(tail) >= 15 else b"") + tail
            return head + data[:at] + b"\x01\x00" + long + rest
    return bytes([min(len(data), 15) << 4]) + (bytes([len(data) - 15]) if len(data) >= 15 else b"") + data


class Writer:
    """A .vtu file in one of VTK's encodings, after VTK's manual."""

    def __init__(self, encoding, header="UInt64", compressor=None, order="<"):
        self.encoding, self.header, self.compressor, self.order = encoding, header, compressor, order
        self.appended = b""

    def heads(self, *numbers):
        return np.array(numbers, self.order + ("u8" if self.header == "UInt64" else "u4")).tobytes()

    def packed(self, data, coded):
        pack = {None: None, "ZLib": zlib.compress, "LZMA": lzma.compress, "LZ4": lz4}[self.compressor]
        if pack is None:
            return coded(self.heads(len(data)) + data)
        size = 64  # small blocks, so that there are several
        blocks = [data[i : i + size] for i in range(0, len(data), size)]
        done = [pack(block) for block in blocks]
        head = self.heads(len(blocks), size, len(data) % size, *map(len, done))
        return coded(head) + coded(b"".join(done))

    def array(self, values, kind, name, extra=""):
        dtype = {"Float64": "f8", "Float32": "f4", "Int64": "i8", "Int32": "i4", "UInt8": "u1"}[kind]
        data = np.asarray(values).astype(self.order + dtype).tobytes()
        head = f'<DataArray type="{kind}" Name="{name}" {extra} format="{self.encoding.split()[0]}"'
        if self.encoding == "ascii":
            return f"{head}>{' '.join(map(str, np.ravel(values).tolist()))}</DataArray>"
        if self.encoding == "binary":
            return f"{head}>\n {self.packed(data, base64.b64encode).decode()}\n</DataArray>"
        start = len(self.appended)
        self.appended += self.packed(data, base64.b64encode if self.encoding.endswith("base64") else bytes)
        return f'{head} offset="{start}"/>'

    def file(self, pieces, version="1.0"):
        body = ""
        for points, (nodes, ends, kinds) in pieces:
            three = 'NumberOfComponents="3"'
            body += (
                f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(kinds)}">'
                f"<Points>{self.array(points, 'Float32', 'Points', three)}</Points><Cells>"
                f"{self.array(nodes, 'Int64', 'connectivity')}{self.array(ends, 'Int32', 'offsets')}"
                f"{self.array(kinds, 'UInt8', 'types')}</Cells></Piece>"
            )
        pack = f'compressor="vtk{self.compressor}DataCompressor"' if self.compressor else ""
        byte_order = "LittleEndian" if self.order == "<" else "BigEndian"
        head = f'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="{version}" byte_order="{byte_order}" '
        text = f'{head}header_type="{self.header}" {pack}>\n<UnstructuredGrid>{body}</UnstructuredGrid>'.encode()
        if self.appended:
            word = b"base64" if self.encoding.endswith("base64") else b"raw"
            text += b'\n<AppendedData encoding="' + word + b'">\n   _' + self.appended + b"\n</AppendedData>"
        return text + b"</VTKFile>\n"


ENCODINGS = ["ascii", "binary", "appended raw", "appended base64"]


@pytest.mark.parametrize(("encoding", "compressor"), [*itertools.product(ENCODINGS, [None, "ZLib", "LZMA", "LZ4"])])
def test_vtu_encodings(tmp_path, encoding, compressor):
    for header, order, version in (("UInt64", "<", "2.2"), ("UInt32", "<", "0.1"), ("UInt32", ">", "1.0")):
        writer = Writer(encoding, header, compressor, order)
        (tmp_path / "part.vtu").write_bytes(writer.file([(POINTS, arrays())], version))
        mesh = read(tmp_path / "part.vtu")
        assert mesh.volume == pytest.approx(VOLUME) and len(mesh.cells) == 6 + 2 + 3 + 1 and len(mesh.points) == 12
        assert "left out: 1 line, 1 triangle (no solids, no group)" in mesh.notes
        assert not any("inside out" in note for note in mesh.notes)


def test_vtu_header_on_its_own(tmp_path):
    """Some writers code the length by itself, with padding between it and the data."""
    writer = Writer("binary", "UInt32")
    writer.packed = lambda data, coded: coded(writer.heads(len(data))) + coded(data)
    (tmp_path / "part.vtu").write_bytes(writer.file([(POINTS, arrays())]))
    assert read(tmp_path / "part.vtu").volume == pytest.approx(VOLUME)


def test_vtu_pieces_and_seams(tmp_path):
    """Pieces of a parallel run each have their own nodes: the seam is told, and merged when asked."""
    shifted = POINTS[:8] + np.array([1.0, 0, 0])
    second = shifted, arrays([(12, [*range(8)])])
    empty = np.zeros((0, 3)), (np.zeros(0, int),) * 3
    (tmp_path / "two.vtu").write_bytes(Writer("ascii").file([(CUBE, arrays(CELLS[:1])), empty, second]))
    assert read(tmp_path / "two.vtu").volume == pytest.approx(2.0) and len(read(tmp_path / "two.vtu").points) == 16
    mesh = read(tmp_path / "two.vtu", merge=True)
    assert len(mesh.points) == 12 and len(mesh.surface) == 20


def test_unusual_cells(tmp_path):
    """Voxels count their corners row by row; cells of any order have their corners first; others are refused."""
    voxel = [0, 1, 3, 2, 4, 5, 7, 6]
    for kind, rows, count in ((11, voxel, 6), (72, [*range(8)], 6), (79, [*range(8)], 6), (71, [0, 1, 3, 4], 1)):
        for name in ("part.vtu", "part.vtk"):
            content = Writer("ascii").file([(CUBE, arrays([(kind, rows)]))]) if name == "part.vtu" else None
            (tmp_path / name).write_bytes(content or legacy([(kind, rows)], CUBE))
            assert len(read(tmp_path / name).cells) == count
    for kind, word in ((16, "hexagonal prism"), (42, "polyhedron"), (99, "VTK type 99")):
        cells = [(10, [0, 1, 3, 4]), (kind, [*range(12)])]
        (tmp_path / "part.vtu").write_bytes(Writer("ascii").file([(POINTS, arrays(cells))]))
        with pytest.raises(MeshError, match=rf"holds 1 .*{word}.* cannot be cut .* leave holes"):
            read(tmp_path / "part.vtu")


def legacy(cells=CELLS, points=POINTS, binary=False, version=4):
    """A legacy file; version 5 has offsets and nodes in two lists."""
    nodes, ends, kinds = arrays(cells)

    def numbers(values, dtype):
        flat = np.ravel(values)
        return flat.astype(dtype).tobytes() if binary else " ".join(map(str, flat.tolist())).encode()

    head = f"# vtk DataFile Version {version}.{1 if version > 4 else 2}\na part\n{'BINARY' if binary else 'ASCII'}\n"
    text = head.encode() + b"DATASET UNSTRUCTURED_GRID\nPOINTS %d float\n" % len(points) + numbers(points, ">f4")
    text += (
        b"\nMETADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1\n\n" if version > 4 else b"\n"
    )
    if version > 4:
        text += b"CELLS %d %d\nOFFSETS vtktypeint64\n" % (len(cells) + 1, len(nodes))
        text += numbers([0, *ends], ">i8") + b"\nCONNECTIVITY vtktypeint64\n" + numbers(nodes, ">i8")
    else:
        flat = [n for _, own in cells for n in (len(own), *own)]
        text += b"CELLS %d %d\n" % (len(cells), len(flat)) + numbers(flat, ">i4")
    text += b"\nCELL_TYPES %d\n" % len(cells) + numbers(kinds, ">i4")
    return (
        text
        + b"\nCELL_DATA %d\nSCALARS part int 1\nLOOKUP_TABLE default\n" % len(cells)
        + numbers(kinds, ">i4")
        + b"\n"
    )


@pytest.mark.parametrize(("binary", "version"), [*itertools.product([False, True], [3, 4, 5])])
def test_legacy_files_with_cells_of_several_kinds(tmp_path, binary, version):
    (tmp_path / "part.vtk").write_bytes(legacy(binary=binary, version=version))
    mesh = read(tmp_path / "part.vtk")
    assert mesh.volume == pytest.approx(VOLUME) and len(mesh.points) == 12
    assert "left out: 1 line, 1 triangle (no solids, no group)" in mesh.notes


def test_files_as_another_program_writes_them(tmp_path):
    blocks = [("hexahedron", [CELLS[0][1]]), ("pyramid", [CELLS[4][1]]), ("tetra", [CELLS[2][1]])]
    mixed = meshio.Mesh(POINTS[[*range(9), 11, 9, 10]], [*blocks[:2], ("tetra", [[0, 4, 3, 9]])])
    for name, options in (
        ("a.vtu", {"binary": True, "compression": "zlib"}),
        ("b.vtu", {"binary": True, "compression": None}),
        ("c.vtu", {"binary": False}),
        ("d.vtk", {"file_format": "vtk42", "binary": True}),
        ("e.vtk", {"file_format": "vtk51", "binary": True}),
        ("f.vtk", {"file_format": "vtk51", "binary": False}),
        ("g.mesh", {}),
        ("h.bdf", {}),
    ):
        mixed.write(tmp_path / name, **options)
        assert read(tmp_path / name).volume == pytest.approx(VOLUME - 0.5), name


def test_nastran_without_its_first_line(tmp_path):
    """As Gmsh writes it."""
    mixed = meshio.Mesh(POINTS[:8], [("hexahedron", [[*range(8)]])])
    mixed.write(tmp_path / "part.bdf")
    text = (tmp_path / "part.bdf").read_text()
    (tmp_path / "part.bdf").write_text(text[text.index("BEGIN BULK") + 10 :].replace("ENDDATA", ""))
    assert read(tmp_path / "part.bdf").volume == pytest.approx(1.0)


def test_surfaces_are_not_volumes(tmp_path):
    polydata = b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 8 float\n"
    polydata += " ".join(map(str, CUBE.ravel().tolist())).encode() + b"\nPOLYGONS 2 9\n4 0 1 2 3\n3 4 5 6\n"
    (tmp_path / "skin.vtk").write_bytes(polydata)
    meshio.Mesh(CUBE, [("triangle", [[0, 1, 2], [0, 2, 3]])]).write(tmp_path / "skin.stl")
    for name, found in (("skin.vtk", r"1 quad, 1 triangle"), ("skin.stl", r"2 triangle")):
        with pytest.raises(
            MeshError, match=rf"holds a surface \({found}\), which has no volume: .*from_convex_surface"
        ):
            read(tmp_path / name)
    assert read_surface(tmp_path / "skin.vtk")[1].shape == (3, 3)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.vtk", legacy()[:300], r"cut short|no CELLS"),
        ("a.vtk", legacy(binary=True)[:190], r"cut short|no CELLS"),
        ("a.vtk", b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n", r"no POINTS"),
        ("a.vtu", Writer("binary").file([(POINTS, arrays())])[:400], r"cannot read"),
        ("a.vtu", b'<VTKFile type="PolyData"></VTKFile>', r"holds a PolyData, not an UnstructuredGrid"),
        (
            "a.vtu",
            b'<VTKFile type="UnstructuredGrid" compressor="vtkPigeonDataCompressor"/>',
            r"vtkPigeonDataCompressor",
        ),
    ],
)
def test_damaged_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=message):
        read(tmp_path / name)
