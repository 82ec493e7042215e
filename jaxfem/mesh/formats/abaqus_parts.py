"""Parts of an Abaqus model, as its keywords fill them: nodes, elements, and sets that may name each other."""

import dataclasses

import numpy as np

from ..checks import Floats, Ints, MeshError
from .abaqus_text import Keyword, fields, whole
from .abaqus_types import kind_and_nodes

GENERATED = ("NGEN", "NFILL", "NCOPY", "ELGEN", "ELCOPY", "NMAP", "SYSTEM", "SUBSTRUCTURE PATH")


@dataclasses.dataclass
class SetOf:
    """Members of a set: numbers and names of other sets, each of an instance ("": the one that has the set)."""

    name: str
    numbers: list[Ints] = dataclasses.field(default_factory=list)
    names: list[tuple[str, str]] = dataclasses.field(default_factory=list)  # the instance to look in, the name
    instanced: list[tuple[str, Ints]] = dataclasses.field(default_factory=list)
    internal: bool = False


@dataclasses.dataclass
class Surface:
    """Faces of elements, as (element or set, identifier like S3); of nodes when `nodal`."""

    name: str
    items: list[tuple[str, str]]
    nodal: bool = False
    internal: bool = False


@dataclasses.dataclass
class Part:
    """What stands between *PART and *END PART, in *INSTANCE, or outside; sets by their name in capitals."""

    name: str
    nodes: list[tuple[Ints, Floats]] = dataclasses.field(default_factory=list)
    elements: list[tuple[str, Ints, Ints]] = dataclasses.field(default_factory=list)  # kind, numbers, nodes
    node_sets: dict[str, SetOf] = dataclasses.field(default_factory=dict)
    element_sets: dict[str, SetOf] = dataclasses.field(default_factory=dict)
    surfaces: dict[str, Surface] = dataclasses.field(default_factory=dict)
    left_out: dict[str, int] = dataclasses.field(default_factory=dict)

    def add(self, keyword: Keyword) -> None:
        """Take in one keyword; those that say nothing of the mesh are passed over."""
        takers = {"NODE": self._node, "ELEMENT": self._element, "SURFACE": self._surface}
        if keyword.word in takers:
            takers[keyword.word](keyword)
        elif keyword.word in ("NSET", "ELSET"):
            sets = self.node_sets if keyword.word == "NSET" else self.element_sets
            self._set(keyword, sets)
        elif keyword.word in GENERATED:
            raise MeshError(
                f"line {keyword.line}: *{keyword.word} makes nodes or elements by rule, which is not read here: write "
                "the whole mesh out (Abaqus: a job's own input file, or CAE's)"
            )

    def own_set(self, sets: dict[str, SetOf], name: str) -> SetOf:
        """The set of a name, made where there is none."""
        return sets.setdefault(name.upper(), SetOf(name))

    def _node(self, keyword: Keyword) -> None:
        rows = [fields(line) for line in keyword.lines]
        try:
            places = np.array([[float(word or 0) for word in (row + ["0"] * 4)[1:4]] for row in rows], dtype=np.float64)
        except ValueError as problem:
            raise MeshError(f"below *NODE in line {keyword.line}: {problem}") from problem
        numbers = whole([row[0] for row in rows], keyword)
        self.nodes.append((numbers, _cartesian(places.reshape(-1, 3), keyword)))
        if "NSET" in keyword.parameters:
            self.own_set(self.node_sets, keyword.parameter("NSET")).numbers.append(numbers)

    def _element(self, keyword: Keyword) -> None:
        name = keyword.parameter("TYPE")
        known = kind_and_nodes(name)
        if known is None:
            count = sum(not line.endswith(",") for line in keyword.lines)
            label = name or "element without a type"
            self.left_out[label] = self.left_out.get(label, 0) + count
            return
        kind, nodes = known
        table = whole(keyword.items(), keyword)
        if len(table) % (nodes + 1):
            raise MeshError(
                f"below *ELEMENT in line {keyword.line}: the elements of type {name} have not {nodes} nodes each"
            )
        table = table.reshape(-1, nodes + 1)
        self.elements.append((kind, table[:, 0], table[:, 1:]))
        if "ELSET" in keyword.parameters:
            self.own_set(self.element_sets, keyword.parameter("ELSET")).numbers.append(table[:, 0])

    def _set(self, keyword: Keyword, sets: dict[str, SetOf]) -> None:
        name = keyword.parameter(keyword.word)
        if not name:
            raise MeshError(f"line {keyword.line}: *{keyword.word} has no name: *{keyword.word}, {keyword.word}=NAME")
        made, instance = self.own_set(sets, name), keyword.parameter("INSTANCE")
        made.internal |= "INTERNAL" in keyword.parameters
        if keyword.word == "NSET" and "ELSET" in keyword.parameters:
            made.names.append((instance, "\0" + keyword.parameter("ELSET")))  # the nodes of these elements
        if "GENERATE" in keyword.parameters:
            rows = [whole([each for each in fields(line) if each], keyword) for line in keyword.lines]
            numbers = [np.arange(row[0], row[1] + 1, row[2] if len(row) > 2 else 1) for row in rows]
            made.instanced.append((instance, np.concatenate([np.zeros(0, np.int64), *numbers])))
            return
        items = keyword.items()
        digits = [each for each in items if each.lstrip("-").isdigit()]
        made.instanced.append((instance, whole(digits, keyword)))
        made.names += [(instance, each) for each in items if not each.lstrip("-").isdigit()]

    def _surface(self, keyword: Keyword) -> None:
        name = keyword.parameter("NAME")
        kind = keyword.parameter("TYPE").upper() or "ELEMENT"
        if kind not in ("ELEMENT", "NODE"):
            self.left_out[f"*SURFACE of type {kind}"] = self.left_out.get(f"*SURFACE of type {kind}", 0) + 1
            return
        rows = [[*fields(line), ""][:2] for line in keyword.lines]
        old = self.surfaces.get(name.upper())
        items = [(first, second.upper()) for first, second in rows]
        hidden = "INTERNAL" in keyword.parameters
        self.surfaces[name.upper()] = Surface(name, (old.items if old else []) + items, kind == "NODE", hidden)


def _cartesian(places: Floats, keyword: Keyword) -> Floats:
    """Coordinates of SYSTEM=R, C (radius, degrees, z) or S (radius, two angles in degrees) as x, y, z."""
    system = keyword.parameter("SYSTEM").upper()[:1] or "R"
    radius, first = places[:, 0], np.radians(places[:, 1])
    if system == "C":
        return np.stack([radius * np.cos(first), radius * np.sin(first), places[:, 2]], axis=1)
    if system == "S":
        up = np.radians(places[:, 2])
        level = radius * np.cos(up)
        return np.stack([level * np.cos(first), level * np.sin(first), radius * np.sin(up)], axis=1)
    return places
