"""Abaqus and CalculiX input files: parts, instances, sets of all kinds, surfaces, element types."""

import numpy as np
import pytest

from jaxfem.mesh import MeshError, read

NODES = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n5,1,1,1\n"
CELLS = "*ELEMENT, TYPE=C3D4, ELSET=BODY\n1, 1,2,3,4\n2, 2,3,4,5\n"
BRICK = "1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,1,0,1\n7,1,1,1\n8,0,1,1\n"
PART = "*PART, NAME=P\n" + NODES + CELLS + "*NSET, NSET=TIP\n5\n*SURFACE, NAME=END\n2, S3\n*END PART\n"


@pytest.fixture
def mesh_of(tmp_path):
    def make(text, **options):
        (tmp_path / "part.inp").write_text(text)
        return read(tmp_path / "part.inp", scale=1.0, **options)

    return make


def test_lower_case_comments_and_lines_that_go_on(mesh_of):
    text = (
        "*heading\n a model, of nothing: 1, 2, 3\n** nodes\n*node , nset = all\n 1 , 0. , 0. , 0. ,\n2,1.\n3,0.,1.e0\n"
        "4,,,1.\n*element,\n type=c3d4, elset=body\n7, 1, 2,\n3, 4\n**end\n*nset, nset=feet, generate\n1, 3, 2\n"
        "*Elset, elset=Half\n7,\n*step\n*static\n*nset, nset=late\n1\n*end step\n"
    )
    mesh = mesh_of(text)
    assert mesh.volume == pytest.approx(1 / 6) and mesh.notes == ()
    assert {name: own.tolist() for name, own in mesh.node_groups.items()} == {"all": [0, 1, 2, 3], "feet": [0, 2]}
    assert {name: own.tolist() for name, own in mesh.cell_groups.items()} == {"body": [0], "Half": [0]}


@pytest.mark.parametrize(
    ("name", "count", "volume"),
    [
        ("C3D8R", 8, 1.0),
        ("C3D8I", 8, 1.0),
        ("C3D20R", 20, 1.0),
        ("C3D27", 27, 1.0),
        ("DC3D8", 8, 1.0),
        ("SC8R", 8, 1.0),
    ],
)
def test_bricks(mesh_of, name, count, volume):
    """Of twenty nodes as of eight, over as many lines as Abaqus takes."""
    middle = "".join(f"{n},.5,.5,.5\n" for n in range(9, count + 1))
    numbers = [str(n) for n in range(1, count + 1)]
    rows = "1, " + ",".join(numbers[:15]) + (",\n" + ",".join(numbers[15:]) if count > 15 else "") + "\n"
    text = f"*NODE\n{BRICK}{middle}*ELEMENT, TYPE={name}\n{rows}*SURFACE, NAME=TOP, TYPE=ELEMENT\n1, S2\n"
    mesh = mesh_of(text)
    assert mesh.volume == pytest.approx(volume) and len(mesh.cells) == 6
    assert len(mesh.faces("TOP")) == 2 and (mesh.points[mesh.faces("TOP")][..., 2] == 1).all()


def test_each_face_of_each_element_type(mesh_of):
    """S1, S2, ... of a brick, a wedge, a pyramid and a tetrahedron are the planes on which they lie in the manual."""
    bricks = {"S1": (2, 0), "S2": (2, 1), "S3": (1, 0), "S4": (0, 1), "S5": (1, 1), "S6": (0, 0)}
    faces = "".join(f"*SURFACE, NAME={s}\n1, {s}\n" for s in bricks)
    mesh = mesh_of(f"*NODE\n{BRICK}*ELEMENT, TYPE=C3D8\n1,1,2,3,4,5,6,7,8\n{faces}")
    for name, (axis, place) in bricks.items():
        assert len(mesh.faces(name)) == 2 and (mesh.points[mesh.faces(name)][..., axis] == place).all()
    wedges = {"S1": [0, 1, 2], "S2": [3, 4, 5], "S3": [0, 1, 3, 4], "S4": [1, 2, 4, 5], "S5": [0, 2, 3, 5]}
    pyramids = {"S1": [0, 1, 2, 3], "S2": [0, 1, 4], "S3": [1, 2, 4], "S4": [2, 3, 4], "S5": [0, 3, 4]}
    tetras = {"S1": [0, 1, 2], "S2": [0, 1, 3], "S3": [1, 2, 3], "S4": [0, 2, 3]}
    places = {
        "C3D6": ("1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n5,1,0,1\n6,0,1,1\n", wedges),
        "C3D5": ("1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n", pyramids),
        "C3D4": ("1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n", tetras),
    }
    for kind, (nodes, wanted) in places.items():
        faces = "".join(f"*SURFACE, NAME={s}\nALL, {s}\n" for s in wanted)
        count = nodes.count("\n")
        row = ",".join(str(n) for n in range(1, count + 1))
        mesh = mesh_of(f"*NODE\n{nodes}*ELEMENT, TYPE={kind}, ELSET=ALL\n9,{row}\n{faces}")
        for name, own in wanted.items():
            assert mesh.nodes(name).tolist() == own, (kind, name)


def test_mixed_kinds_and_quadratic_tetrahedra(mesh_of):
    ten = "".join(f"{n},.5,.5,{z}\n" for n, z in zip(range(10, 16), range(6), strict=True))
    mesh = mesh_of(
        f"*NODE\n{BRICK}9,.5,.5,2\n{ten}*ELEMENT, TYPE=C3D8, ELSET=BASE\n1, 1,2,3,4,5,6,7,8\n"
        "*ELEMENT, TYPE=C3D10, ELSET=CAP\n2, 5,6,7,9,10,11,12,13,14,15\n*ELEMENT, TYPE=C3D4, ELSET=CAP\n3, 5,7,8,9\n"
        "*ELEMENT, TYPE=MASS, ELSET=M\n4, 9\n*ELEMENT, TYPE=SPRINGA\n5, 1, 2\n"
    )
    assert mesh.volume == pytest.approx(4 / 3)
    assert mesh.volumes[mesh.cell_groups["BASE"]].sum() == pytest.approx(1.0)
    assert mesh.volumes[mesh.cell_groups["CAP"]].sum() == pytest.approx(1 / 3)
    text = "; ".join(mesh.notes)
    assert "1 hexahedron was cut" in text and "1 quadratic element was made linear" in text
    assert "left out: 1 MASS, 1 SPRINGA" in text


def test_sets_of_sets(mesh_of):
    mesh = mesh_of(
        NODES + CELLS + "*NSET, NSET=A\n1, 2\n*NSET, NSET=C\nA, B, 5\n*NSET, NSET=B, GENERATE\n3, 4\n"
        '*NSET, NSET="the body", ELSET=BODY\n*ELSET, ELSET=E, GENERATE\n1, 2, 1\n*ELSET, ELSET=F\nE\n'
        "*NSET, NSET=_made, INTERNAL\n1\n"
    )
    assert mesh.nodes("C").tolist() == [0, 1, 2, 3, 4] == mesh.nodes("the body").tolist()
    assert mesh.cell_groups["F"].tolist() == [0, 1] and "_made" not in mesh.node_groups
    with pytest.raises(MeshError, match=r"the set A holds itself"):
        mesh_of(NODES + CELLS + "*NSET, NSET=A\nB\n*NSET, NSET=B\nA\n")
    with pytest.raises(MeshError, match=r'A names "NONE", which is no set of the file'):
        mesh_of(NODES + CELLS + "*NSET, NSET=A\nNONE\n")


def test_surfaces(mesh_of):
    """By number, by set, of all free faces, of other surfaces, of nodes; on shells with either side."""
    mesh = mesh_of(
        NODES + CELLS + "*SURFACE, NAME=ONE\n1, S1\n*SURFACE, NAME=SET, TYPE=ELEMENT\nBODY, S2\n"
        "*SURFACE, NAME=FREE\nBODY,\n*SURFACE, NAME=ALL\n,\n*SURFACE, NAME=BOTH, COMBINE=UNION\nONE, SET\n"
        "*SURFACE, NAME=TWO\nONE,\nSET,\n*SURFACE, NAME=DOTS, TYPE=NODE\n1, 2.\n5,\n"
        "*ELEMENT, TYPE=S3, ELSET=SKIN\n8, 1,2,3\n*SURFACE, NAME=SIDE\nSKIN, SPOS\n*SURFACE, NAME=BAD\n1, S5\n"
    )
    assert np.sort(mesh.faces("ONE")).tolist() == [[0, 1, 2]] == np.sort(mesh.faces("SIDE")).tolist()
    assert np.sort(mesh.faces("SET")).tolist() == [[0, 1, 3], [1, 2, 4]] or len(mesh.faces("SET")) == 2
    assert len(mesh.faces("FREE")) == len(mesh.faces("ALL")) == len(mesh.surface) == 6
    assert len(mesh.faces("TWO")) == 3 and mesh.nodes("DOTS").tolist() == [0, 4]
    assert any('surface "BAD": "S5" is no face of a tetra' in note for note in mesh.notes)


def test_instances_moved_and_turned(mesh_of):
    """The translation comes first, then the turn about the axis through two points."""
    mesh = mesh_of(
        PART + "*ASSEMBLY, NAME=Q\n*INSTANCE, NAME=A-1, PART=P\n*END INSTANCE\n*INSTANCE, NAME=b, PART=p\n3., 0., 0.\n"
        "3., 0., 0., 3., 0., 1., 90.\n*END INSTANCE\n*NSET, NSET=MINE, INSTANCE=A-1\n1, TIP\n"
        "*NSET, NSET=MINE, INSTANCE=b\n1\n"
        "*NSET, NSET=DOT\nb.2, A-1.TIP\n*ELSET, ELSET=SECOND\nb.BODY\n*SURFACE, NAME=JOIN\nb.BODY, S1\n*END ASSEMBLY\n"
    )
    assert len(mesh.cells) == 4 and mesh.volume == pytest.approx(2 * (1 / 6 + 1 / 3))
    first = mesh.points[:5]
    np.testing.assert_allclose(mesh.points[5:], first @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] + [3, 0, 0], atol=1e-12)
    assert mesh.nodes("A-1.TIP").tolist() == [4] and mesh.nodes("b.TIP").tolist() == [9]
    assert mesh.nodes("TIP").tolist() == [4, 9] and mesh.nodes("MINE").tolist() == [0, 4, 5]
    assert mesh.nodes("DOT").tolist() == [4, 6] and mesh.cell_groups["SECOND"].tolist() == [2, 3]
    assert mesh.cell_groups["b"].tolist() == [2, 3] and len(mesh.faces("JOIN")) == 2
    assert len(mesh.faces("b.END")) == 1 and len(mesh.faces("END")) == 2


def test_a_mesh_in_its_instance_and_parts_of_which_there_is_none(mesh_of):
    """Independent instances have their own nodes; a file of parts alone shows each where it is."""
    other = PART.replace("NAME=P\n", "NAME=IDLE\n")
    mesh = mesh_of(
        other
        + "*PART, NAME=E\n*END PART\n*ASSEMBLY, NAME=Q\n*INSTANCE, NAME=I, PART=E\n0, 0, 2.\n"
        + NODES
        + CELLS
        + "*END INSTANCE\n*NODE\n1, 9., 9., 9.\n*END ASSEMBLY\n"
    )
    assert len(mesh.cells) == 2 and mesh.points[:, 2].min() == 2.0
    assert any("left out: part IDLE" in note for note in mesh.notes)
    assert any("1 node without an element was dropped" in note for note in mesh.notes)
    assert mesh_of(PART).volume == pytest.approx(0.5)
    with pytest.raises(MeshError, match=r'INSTANCE "A" is of part "X", which the file does not hold'):
        mesh_of(PART + "*INSTANCE, NAME=A, PART=X\n*END INSTANCE\n")


def test_included_files_and_other_systems(mesh_of, tmp_path):
    (tmp_path / "nodes.inc").write_text(NODES)
    assert mesh_of("*INCLUDE, INPUT=nodes.inc\n" + CELLS).volume == pytest.approx(0.5)
    with pytest.raises(MeshError, match=r"line 1 includes gone.inc, which is not beside it"):
        mesh_of("*INCLUDE, INPUT=gone.inc\n" + CELLS)
    mesh = mesh_of("*NODE, SYSTEM=C\n1,0,0,0\n2,1,0,0\n3,1,90,0\n4,0,0,1\n*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n")
    np.testing.assert_allclose(mesh.points[2], [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("*NODE\n1,0,0,0\n*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n", r"uses node 2, which the file does not hold"),
        (NODES + "*ELEMENT, TYPE=C3D4\n1,1,2,3\n", r"line 7: the elements of type C3D4 have not 4 nodes each"),
        ("*NODE\n1,a,0,0\n", r"below \*NODE in line 1: .*'a'"),
        (NODES + "*NGEN\n1,3\n" + CELLS, r"\*NGEN makes nodes or elements by rule"),
        (NODES + "*ELEMENT, TYPE=S3\n1,1,2,3\n", r"holds a surface \(1 triangle\), which has no volume"),
        (PART + "*INSTANCE, NAME=A, PART=P\n0,0,0\n0,0,0,0,0,0,90\n*END INSTANCE\n", r"needs two different points"),
    ],
)
def test_what_cannot_be_read_is_named(mesh_of, text, message):
    with pytest.raises(MeshError, match=message):
        mesh_of(text)
