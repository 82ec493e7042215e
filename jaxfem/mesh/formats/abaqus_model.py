"""An Abaqus model put together: instances' nodes and elements in one list, sets and surfaces looked up among them."""

import dataclasses
from collections.abc import Callable

import numpy as np

from ..checks import Floats, Ints, MeshError, first_equal
from ..raw import CORNERS, RawMesh, dimension, shape_of
from .abaqus_parts import Part, SetOf, Surface
from .abaqus_types import FACES

EMPTY = np.zeros(0, np.int64)


@dataclasses.dataclass
class Scope:
    """Where numbers and names of one instance, or of the assembly (""), mean something."""

    name: str
    part: Part
    nodes: tuple[Ints, Ints]  # numbers in order, places in the model's list
    elements: tuple[Ints, Ints]


class Model:
    """Takes instances one after the other; `mesh` gives all of them."""

    def __init__(self) -> None:
        self.scopes: dict[str, Scope] = {}
        self.points: list[Floats] = []
        self.blocks: list[tuple[str, Ints]] = []
        self.left_out: dict[str, int] = {}
        self._nodes = self._elements = 0

    def place(self, name: str, part: Part, moved: Callable[[Floats], Floats]) -> None:
        """Add a part under an instance's name, its points moved."""
        numbers = np.concatenate([EMPTY, *(each for each, _ in part.nodes)])
        points = np.concatenate([np.zeros((0, 3)), *(places for _, places in part.nodes)])
        nodes = _lookup(numbers, self._nodes)
        self.points.append(moved(points))
        self._nodes += len(points)
        labels = []
        for kind, own, rows in part.elements:
            self.blocks.append((kind, _found(nodes, rows, f"{kind} of {name or 'the file'}")))
            labels.append(own)
        elements = _lookup(np.concatenate([EMPTY, *labels]), self._elements)
        self._elements += sum(len(own) for own in labels)
        self.scopes[name.upper()] = Scope(name, part, nodes, elements)
        for what, count in part.left_out.items():
            self.left_out[what] = self.left_out.get(what, 0) + count

    def mesh(self) -> RawMesh:
        """The model's mesh with all its sets; those that Abaqus made for itself are left out."""
        self._starts = np.cumsum([0] + [len(rows) for _, rows in self.blocks])
        raw = RawMesh(np.concatenate([np.zeros((0, 3)), *self.points]), self.blocks, left_out=dict(self.left_out))
        several = len(self.scopes) > 2
        cells: dict[str, list[Ints]] = {}
        nodes: dict[str, list[Ints]] = {}
        for scope in self.scopes.values():
            own = {name for each in (scope.part.node_sets, scope.part.element_sets) for name in each}
            if several and scope.name and scope.name.upper() not in own:
                cells.setdefault(scope.name, []).append(scope.elements[1])
            for each in scope.part.element_sets.values():
                self._keep(cells, scope, each, self._members(scope, each, True, ()))
            for each in scope.part.node_sets.values():
                self._keep(nodes, scope, each, self._members(scope, each, False, ()))
            for surface in scope.part.surfaces.values():
                self._surface(raw, scope, surface, nodes)
        raw.node_sets = {name: np.unique(np.concatenate(found)) for name, found in nodes.items()}
        raw.cell_sets = {name: self._by_block(np.unique(np.concatenate(found))) for name, found in cells.items()}
        return raw

    def _keep(self, found: dict[str, list[Ints]], scope: Scope, each: SetOf | Surface, members: Ints) -> None:
        if each.internal or each.name.startswith("_"):
            return
        for name in _names(scope, each.name, self.scopes[""].part, each):
            found.setdefault(name, []).append(members)

    def _by_block(self, numbers: Ints) -> list[tuple[int, Ints]]:
        block = np.searchsorted(self._starts, numbers, side="right") - 1
        return [(int(i), numbers[block == i] - self._starts[i]) for i in np.unique(block)]

    def _members(self, scope: Scope, of: SetOf, elements: bool, seen: tuple[str, ...]) -> Ints:
        """Places of a set's elements or nodes in the model's lists; what is not there is passed over."""
        if of.name.upper() in seen:
            raise MeshError(f"the set {of.name} holds itself")
        seen = (*seen, of.name.upper())
        made = [_known(scope.elements if elements else scope.nodes, numbers) for numbers in of.numbers]
        for instance, numbers in of.instanced:
            where = self._scope(instance, of.name) if instance else scope
            made.append(_known(where.elements if elements else where.nodes, numbers))
        for instance, name in of.names:
            where = self._scope(instance, of.name) if instance else scope
            made.append(self._named(where, name, elements, of.name, () if where is not scope else seen))
        return np.concatenate([EMPTY, *made])

    def _scope(self, name: str, user: str) -> Scope:
        if name.upper() not in self.scopes:
            raise MeshError(f'{user} names the instance "{name}", which the file does not hold')
        return self.scopes[name.upper()]

    def _named(self, scope: Scope, name: str, elements: bool, user: str, seen: tuple[str, ...] = ()) -> Ints:
        """Places of what a name, or INSTANCE.NAME, or INSTANCE.NUMBER stands for."""
        if name.startswith("\0"):
            numbers = self._named(scope, name[1:], True, user)
            return np.unique(self._nodes_of(numbers))
        sets = scope.part.element_sets if elements else scope.part.node_sets
        if name.upper() in sets:
            return self._members(scope, sets[name.upper()], elements, seen)
        if not elements and name.upper() in scope.part.element_sets:
            return np.unique(self._nodes_of(self._named(scope, name, True, user)))
        for place in (i for i, letter in enumerate(name) if letter == "."):
            inner = self.scopes.get(name[:place].upper())
            rest = name[place + 1 :]
            if inner is not None and rest.isdigit():
                return _known(inner.elements if elements else inner.nodes, np.array([int(rest)]))
            if inner is not None:
                return self._named(inner, rest, elements, user)
        if name.isdigit():
            return _known(scope.elements if elements else scope.nodes, np.array([int(name)]))
        raise MeshError(f'{user} names "{name}", which is no set of the file')

    def _nodes_of(self, numbers: Ints) -> Ints:
        return np.concatenate([EMPTY, *(self.blocks[i][1][own].ravel() for i, own in self._by_block(numbers))])

    def _surface(self, raw: RawMesh, scope: Scope, surface: Surface, nodes: dict[str, list[Ints]]) -> None:
        if surface.nodal:
            members = [self._named(scope, item, False, surface.name) for item, _ in surface.items]
            self._keep(nodes, scope, surface, np.concatenate([EMPTY, *members]))
            return
        faces = self._faces(scope, surface, raw, ())
        if surface.internal or surface.name.startswith("_"):
            return
        for name in _names(scope, surface.name, self.scopes[""].part, surface):
            raw.face_sets.setdefault(name, []).extend(faces)

    def _faces(self, scope: Scope, surface: Surface, raw: RawMesh, seen: tuple[str, ...]) -> list[Ints]:
        """Faces (k, 3) and (k, 4) of a surface: identified ones, or all that are outside where none is named."""
        made: list[Ints] = []
        if surface.name.upper() in seen:
            raise MeshError(f"the surface {surface.name} holds itself")
        for item, label in surface.items:
            other = scope.part.surfaces.get(item.upper())
            if other is not None and item.upper() not in scope.part.element_sets:
                made += self._faces(scope, other, raw, (*seen, surface.name.upper()))
                continue
            every = not item  # an empty name: the whole model
            members = np.arange(self._starts[-1]) if every else self._named(scope, item, True, surface.name)
            for block, own in self._by_block(members):
                made += self._block_faces(block, own, label, surface, raw)
        return made

    def _block_faces(self, block: int, own: Ints, label: str, surface: Surface, raw: RawMesh) -> list[Ints]:
        kind, rows = self.blocks[block]
        shape = shape_of(kind) or ""
        if dimension(kind) == 2:
            return [rows[own][:, : CORNERS[shape][0]]]
        if dimension(kind) != 3:
            return []
        if not label:
            return self._outside(block, own)
        number = int(label[1:]) - 1 if label[:1] == "S" and label[1:].isdigit() else -1
        if not 0 <= number < len(FACES[shape]):
            raw.notes.append(f'surface "{surface.name}": "{label}" is no face of a {shape}; left out')
            return []
        return [rows[own][:, FACES[shape][number]]]

    def _outside(self, block: int, own: Ints) -> list[Ints]:
        """Those faces of elements that no other element of the model shares."""
        keys, made = [], []
        for i, (kind, rows) in enumerate(self.blocks):
            for face in FACES.get(shape_of(kind) or "", ()):
                nodes = rows[:, face]
                keys.append(np.pad(nodes, ((0, 0), (0, 4 - len(face))), constant_values=-1))
                made.append((i, np.arange(len(rows)), nodes))
        first = first_equal(np.concatenate(keys))
        alone = np.bincount(first, minlength=len(first))[first] == 1
        parts = np.split(alone, np.cumsum([len(nodes) for _, _, nodes in made])[:-1])
        return [
            nodes[mask & np.isin(numbers, own)]
            for (i, numbers, nodes), mask in zip(made, parts, strict=True)
            if i == block
        ]


def _names(scope: Scope, name: str, top: Part, each: SetOf | Surface) -> list[str]:
    """What a set is called: in an instance INSTANCE.NAME, and NAME where the assembly has none of that name."""
    if not scope.name:
        return [name]
    taken = {*top.node_sets, *top.element_sets, *top.surfaces}
    return [f"{scope.name}.{name}"] + ([] if name.upper() in taken else [name])


def _lookup(numbers: Ints, start: int) -> tuple[Ints, Ints]:
    """Numbers in order, and the place of each; of a number that is there twice the last counts."""
    order = np.argsort(numbers, kind="stable")
    ordered = numbers[order]
    last = np.ones(len(ordered), bool)
    last[:-1] = ordered[1:] != ordered[:-1]
    return ordered[last], order[last] + start


def _known(table: tuple[Ints, Ints], numbers: Ints) -> Ints:
    """Places of those numbers that are there."""
    known, places = table
    if not len(known):
        return EMPTY
    found = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
    chosen: Ints = places[found][known[found] == numbers]
    return chosen


def _found(table: tuple[Ints, Ints], rows: Ints, what: str) -> Ints:
    """Places of all numbers; MeshError names the first that is not there."""
    known, places = table
    found = np.minimum(np.searchsorted(known, rows), max(len(known) - 1, 0))
    wrong = known[found] != rows if len(known) else np.ones(rows.shape, bool)
    if wrong.any():
        raise MeshError(f"a {what} uses node {int(rows[wrong][0])}, which the file does not hold")
    chosen: Ints = places[found]
    return chosen
