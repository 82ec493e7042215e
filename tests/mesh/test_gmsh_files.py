"""Gmsh files of versions 1, 2 and 4, text and binary: partial groups, elements in several groups, partitions."""

import struct

import meshio
import numpy as np
import pytest

from jaxfem.mesh import MeshError, read

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
NAMES = '$PhysicalNames\n3\n2 1 "base"\n3 3 "bulk"\n3 4 "upper half"\n$EndPhysicalNames\n'
# Numbers of nodes and elements are not in order and leave gaps, as after meshing parts anew.
NUMBERS = [11, 2, 30, 4, 5]
ENTITIES = (
    "$Entities\n1 1 2 2\n7 0 0 0 1 9 \n1 0 0 0 1 0 0 0 2 7 -7 \n1 0 0 0 1 1 0 1 1 1 1 \n2 0 0 0 1 1 1 0 0 \n"
    "1 0 0 0 1 1 1 1 3 0 \n2 0 0 0 1 1 1 2 3 -4 1 1 \n$EndEntities\n"
)
BLOCKS = [(2, 1, 2, [(1, [11, 2, 30])]), (2, 2, 2, [(20, [11, 2, 4])])]
BLOCKS += [(3, 1, 4, [(3, [11, 2, 30, 4])]), (3, 2, 4, [(9, [2, 30, 4, 5])])]


def text_41():
    rows = "\n".join(" ".join(f"{x:g}" for x in point) for point in POINTS)
    nodes = f"$Nodes\n1 5 2 30\n3 1 0 5\n{chr(10).join(map(str, NUMBERS))}\n{rows}\n$EndNodes\n"
    blocks = "".join(
        f"{dim} {entity} {kind} {len(own)}\n" + "".join(f"{n} {' '.join(map(str, each))}\n" for n, each in own)
        for dim, entity, kind, own in BLOCKS
    )
    return f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{NAMES}{ENTITIES}{nodes}$Elements\n4 4 1 20\n{blocks}$EndElements\n"


def text_40():
    rows = "".join(f"{n} {' '.join(f'{x:g}' for x in p)}\n" for n, p in zip(NUMBERS, POINTS, strict=True))
    text = text_41().replace("4.1 0 8", "4 0 8").replace("\n7 0 0 0 1 9 \n", "\n7 0 0 0 0 0 0 1 9 \n")
    text = text[: text.index("$Nodes")] + f"$Nodes\n1 5\n1 3 0 5\n{rows}$EndNodes\n" + text[text.index("$Elements") :]
    for dim, entity, kind, _ in BLOCKS:
        text = text.replace(f"{dim} {entity} {kind} 1\n", f"{entity} {dim} {kind} 1\n")
    return text.replace("4 4 1 20\n", "4 4\n")


def binary_41():
    """The same in bytes, written by hand after the manual."""

    def entity(number, box, tags, bounds):
        tail = b"" if bounds is None else struct.pack(f"<Q{len(bounds)}i", len(bounds), *bounds)
        return struct.pack(f"<i{len(box)}dQ{len(tags)}i", number, *box, len(tags), *tags) + tail

    box = [0.0] * 3 + [1.0] * 3
    entities = struct.pack("<4Q", 1, 1, 2, 2) + entity(7, [0.0] * 3, [9], None) + entity(1, box, [], [7, -7])
    entities += (
        entity(1, box, [1], [1]) + entity(2, box, [], []) + entity(1, box, [3], []) + entity(2, box, [3, -4], [1])
    )
    nodes = struct.pack("<4Q3iQ5Q", 1, 5, 2, 30, 3, 1, 0, 5, *NUMBERS) + POINTS.astype("<f8").tobytes()
    elements = struct.pack("<4Q", 4, 4, 1, 20)
    for dim, number, kind, own in BLOCKS:
        elements += struct.pack("<3iQ", dim, number, kind, len(own))
        elements += b"".join(struct.pack(f"<Q{len(each)}Q", n, *each) for n, each in own)
    parts = [("Entities", entities), ("Nodes", nodes), ("Elements", elements)]
    head = b"$MeshFormat\n4.1 1 8\n" + struct.pack("<i", 1) + b"\n$EndMeshFormat\n" + NAMES.encode()
    return head + b"".join(b"$%s\n%s\n$End%s\n" % (name.encode(), own, name.encode()) for name, own in parts)


def text_22():
    """An element in two groups stands there twice, as Gmsh writes it."""
    rows = "".join(f"{n} {' '.join(f'{x:g}' for x in p)}\n" for n, p in zip(NUMBERS, POINTS, strict=True))
    lines = [
        "1 2 2 1 1 11 2 30",
        "2 2 2 0 2 11 2 4",
        "3 4 2 3 1 11 2 30 4",
        "4 4 2 3 2 2 30 4 5",
        "5 4 4 4 2 1 1 2 30 4 5",
    ]
    elements = "\n".join(lines)
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n{NAMES}$Nodes\n5\n{rows}$EndNodes\n"
        f"$Elements\n5\n{elements}\n$EndElements\n"
    )


def binary_22():
    nodes = b"".join(struct.pack(">i3d", n, *p) for n, p in zip(NUMBERS, POINTS, strict=True))
    runs = [
        (2, 2, [(1, 1, 1, 11, 2, 30), (2, 0, 2, 11, 2, 4)]),
        (4, 2, [(3, 3, 1, 11, 2, 30, 4), (4, 3, 2, 2, 30, 4, 5)]),
    ]
    runs += [(4, 2, [(5, 4, 2, 2, 30, 4, 5)])]
    elements = b"".join(
        struct.pack(">3i", kind, len(own), tags) + b"".join(struct.pack(f">{len(row)}i", *row) for row in own)
        for kind, tags, own in runs
    )
    head = b"$MeshFormat\n2.2 1 8\n" + struct.pack(">i", 1) + b"\n$EndMeshFormat\n" + NAMES.encode()
    return head + b"$Nodes\n5\n" + nodes + b"\n$EndNodes\n$Elements\n5\n" + elements + b"\n$EndElements\n"


@pytest.mark.parametrize("write", [text_41, text_40, binary_41, text_22, binary_22])
def test_groups_of_every_version(tmp_path, write):
    """One triangle in no group, one tetrahedron in two; binary files of either order of bytes."""
    content = write()
    (tmp_path / "part.msh").write_bytes(content if isinstance(content, bytes) else content.encode())
    mesh = read(tmp_path / "part.msh")
    np.testing.assert_array_equal(mesh.points, POINTS)
    assert mesh.volume == pytest.approx(0.5) and mesh.notes == ()
    assert np.sort(mesh.faces("base")).tolist() == [[0, 1, 2]]
    assert mesh.cell_groups["bulk"].tolist() == [0, 1] and mesh.cell_groups["upper half"].tolist() == [1]
    assert set(mesh.face_groups) == {"base"} and mesh.node_groups == {}


def test_version_1(tmp_path):
    rows = "".join(f"{n} {' '.join(f'{x:g}' for x in p)}\n" for n, p in zip(NUMBERS, POINTS, strict=True))
    elements = "3\n1 2 7 1 3 11 2 30\n2 4 1 1 4 11 2 30 4\n3 4 2 1 4 2 30 4 5\n"
    (tmp_path / "old.msh").write_text(f"$NOD\n5\n{rows}$ENDNOD\n$ELM\n{elements}$ENDELM\n")
    mesh = read(tmp_path / "old.msh")
    assert mesh.volume == pytest.approx(0.5) and np.sort(mesh.faces("7")).tolist() == [[0, 1, 2]]
    assert {name: own.tolist() for name, own in mesh.cell_groups.items()} == {"1": [0], "2": [1]}


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", ["gmsh", "gmsh22"])
def test_bricks_and_quadratic_cells_as_another_program_writes_them(tmp_path, version, binary):
    cube = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    points = np.concatenate([cube, np.full((12, 3), 0.5), [[0.5, 0.5, 2.0]]])
    for block, volume in (("hexahedron20", [*range(20)]), 1.0), (("pyramid", [4, 5, 6, 7, 20]), 1 / 3):
        raw = meshio.Mesh(points, [(block[0], [block[1]])])
        raw.write(tmp_path / "part.msh", file_format=version, binary=binary)
        assert read(tmp_path / "part.msh").volume == pytest.approx(volume)


def test_nodes_with_parameters(tmp_path):
    """Mesh.SaveParametric: what follows a place on its curve or surface is passed over."""
    text = text_22().replace("Nodes\n", "ParametricNodes\n").replace("\n2 1 0 0\n", "\n2 1 0 0 1 5 0.25\n")
    (tmp_path / "part.msh").write_text(text.replace("\n4 0 0 1\n", "\n4 0 0 1 2 3 0.5 0.25\n"))
    np.testing.assert_array_equal(read(tmp_path / "part.msh").points, POINTS)
    (tmp_path / "part.msh").write_bytes(binary_22().replace(b"Nodes\n", b"ParametricNodes\n"))
    with pytest.raises(MeshError, match="parametric and binary: save it without"):
        read(tmp_path / "part.msh")


def test_groups_on_surfaces_only(tmp_path):
    """With physical surfaces alone and all saved, the volume is in no group and still there."""
    text = text_41().replace("1 0 0 0 1 1 1 1 3 0", "1 0 0 0 1 1 1 0 0").replace("2 3 -4 1 1 \n$End", "0 1 1 \n$End")
    (tmp_path / "part.msh").write_text(text)
    mesh = read(tmp_path / "part.msh")
    assert len(mesh.cells) == 2 and set(mesh.face_groups) == {"base"} and mesh.cell_groups == {}
    # Without Mesh.SaveAll Gmsh writes the surfaces only: then there is nothing to fill.
    start = text.index("$Elements")
    (tmp_path / "skin.msh").write_text(text[:start] + "$Elements\n1 1 1 1\n2 1 2 1\n1 11 2 30\n$EndElements\n")
    with pytest.raises(MeshError, match=r"holds a surface \(1 triangle\), which has no volume"):
        read(tmp_path / "skin.msh")


def test_partitions_carry_their_parents_groups(tmp_path):
    entities = (
        "$PartitionedEntities\n2\n0\n0 0 1 2\n5 2 1 1 1 0 0 0 1 1 0 1 1 0 \n"
        "5 3 1 1 1 0 0 0 1 1 1 0 0 \n6 3 2 1 2 0 0 0 1 1 1 2 3 4 0 \n$EndPartitionedEntities\n"
    )
    text = text_41().replace("$Nodes", entities + "$Nodes", 1)
    for old, new in (("2 1 2 1\n1 11", "2 5 2 1\n1 11"), ("3 1 4 1\n", "3 5 4 1\n"), ("3 2 4 1\n", "3 6 4 1\n")):
        text = text.replace(old, new)
    (tmp_path / "part.msh").write_text(text)
    mesh = read(tmp_path / "part.msh")
    assert mesh.cell_groups["bulk"].tolist() == [0, 1] and mesh.cell_groups["upper half"].tolist() == [1]
    assert len(mesh.faces("base")) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t[: t.index("$EndNodes")], r"section \$Nodes does not end: the file is cut short"),
        (lambda t: t.replace("9 2 30 4 5", "9 2 30 4 6"), r"uses node 6, which the file does not hold"),
        (lambda t: t.replace("3 2 4 1\n", "3 2 99 1\n"), r"elements of Gmsh's type 99"),
        (lambda t: t.replace("9 2 30 4 5\n", ""), r"numbers are missing: the file is cut short"),
    ],
)
def test_damaged_files_are_refused(tmp_path, change, message):
    (tmp_path / "part.msh").write_text(change(text_41()))
    with pytest.raises(MeshError, match=message):
        read(tmp_path / "part.msh")
