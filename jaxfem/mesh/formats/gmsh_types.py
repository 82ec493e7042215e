"""Gmsh's element types: number -> shape and how many nodes (Gmsh manual, section MSH file format)."""

TYPES = {
    15: ("vertex", 1),
    **{1: ("line", 2), 8: ("line", 3), 26: ("line", 4), 27: ("line", 5), 28: ("line", 6)},
    **{2: ("triangle", 3), 9: ("triangle", 6), 20: ("triangle", 9), 21: ("triangle", 10), 22: ("triangle", 12)},
    **{23: ("triangle", 15), 24: ("triangle", 15), 25: ("triangle", 21)},
    **{3: ("quad", 4), 10: ("quad", 9), 16: ("quad", 8), 36: ("quad", 16), 37: ("quad", 25), 39: ("quad", 12)},
    **{4: ("tetra", 4), 11: ("tetra", 10), 29: ("tetra", 20), 30: ("tetra", 35), 31: ("tetra", 56)},
    **{5: ("hexahedron", 8), 12: ("hexahedron", 27), 17: ("hexahedron", 20), 92: ("hexahedron", 64)},
    93: ("hexahedron", 125),
    **{6: ("wedge", 6), 13: ("wedge", 18), 18: ("wedge", 15), 90: ("wedge", 40), 91: ("wedge", 75)},
    **{7: ("pyramid", 5), 14: ("pyramid", 14), 19: ("pyramid", 13), 118: ("pyramid", 30), 119: ("pyramid", 55)},
}
LINEAR = {"vertex": 1, "line": 2, "triangle": 3, "quad": 4, "tetra": 4, "hexahedron": 8, "wedge": 6, "pyramid": 5}


def kind_and_nodes(number: int) -> tuple[str, int]:
    """The kind of cell, as `RawMesh` names it, and its nodes; ValueError for an unknown type."""
    if number not in TYPES:
        raise ValueError(f"it holds elements of Gmsh's type {number}, which are not known here")
    shape, nodes = TYPES[number]
    return (shape if LINEAR[shape] == nodes else f"{shape}{nodes}"), nodes
