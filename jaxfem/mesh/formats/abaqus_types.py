"""Abaqus' element types and the numbering of their faces (Abaqus Analysis User's Guide, Elements)."""

import re

SOLIDS = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra", 13: "pyramid", 15: "wedge"}
SOLIDS |= {20: "hexahedron", 27: "hexahedron"}
LINEAR = {"tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8, "triangle": 3, "quad": 4, "line": 2}
FLAT = {3: "triangle", 4: "quad", 6: "triangle", 8: "quad", 9: "quad"}
OTHERS = {"STRI3": ("triangle", 3), "STRI65": ("triangle", 6), "SC6R": ("wedge", 6), "SC8R": ("hexahedron", 8)}
OTHERS |= {"CSS8": ("hexahedron", 8), "DS3": ("triangle", 3), "DS4": ("quad", 4), "DS6": ("triangle", 6)}
OTHERS |= {"DS8": ("quad", 8)}

FACES = {  # S1, S2, ... : places of the corners in an element's list
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "hexahedron": ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    "wedge": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
    "pyramid": ((0, 1, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0)),
}


def kind_and_nodes(name: str) -> tuple[str, int] | None:
    """The kind of cell of an element type, as `RawMesh` names it, and its nodes; None where it is no cell."""
    word = name.upper()
    found = _shape(word)
    if found is None:
        return None
    shape, nodes = found
    return (shape if LINEAR[shape] == nodes else f"{shape}{nodes}"), nodes


def _shape(word: str) -> tuple[str, int] | None:
    if word in OTHERS:
        return OTHERS[word]
    solid = re.match(r"[ADEFQ]?C?C3D(\d+)(?![\dD])", word)
    if solid and int(solid[1]) in SOLIDS:
        return SOLIDS[int(solid[1])], int(solid[1])
    flat = re.match(r"(?:S|R3D|M3D|SFM3D|CPS|CPE|CPEG|CAX|CGAX|DC2D|F3D|S8R|DCAX|SAX)(\d)(?!\d)", word)
    if flat and int(flat[1]) in FLAT and not word.startswith("SAX"):
        return FLAT[int(flat[1])], int(flat[1])
    line = re.match(r"(?:T[23]D|B[23]|DC1D|RB[23]D)(\d)(?!\d)", word)
    if line:
        nodes = 3 if (line[1] == "3" and word.startswith("T")) or re.match(r"B[23]2", word) else 2
        return "line", nodes
    return None
