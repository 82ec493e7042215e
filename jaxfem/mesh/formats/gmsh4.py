"""Gmsh's files of versions 4.0 and 4.1: nodes and elements in blocks, one for each entity of the geometry.

An entity has any number of physical groups, which its elements have too; those of no group stay, and are in no set.
"""

from collections.abc import Mapping

import numpy as np

from ..checks import Floats, Ints
from ..raw import RawMesh
from .gmsh_types import kind_and_nodes
from .numbers import Numbers, node_index

Groups = dict[tuple[int, int], list[int]]  # (dimension, number) of an entity -> its physical groups


def read_4(sections: Mapping[str, Numbers], names: Mapping[tuple[int, int], str], version: float) -> RawMesh:
    """The mesh of a file's sections; `names`: (dimension, number) -> name of its physical groups."""
    newer = version >= 4.1
    groups: Groups = {}
    if "Entities" in sections:
        _entities(sections["Entities"], groups, newer)
    if "PartitionedEntities" in sections:
        _partitioned(sections["PartitionedEntities"], groups, newer)
    numbers, points = _nodes(sections["Nodes"], newer)
    index = node_index(numbers)
    raw = RawMesh(points, [])
    named: set[int] = {dim for dim, _ in names}
    used = {dim: {each for (own, _), many in groups.items() if own == dim for each in many} for dim in range(4)}
    for dim, entity, kind, rows in _elements(sections["Elements"], newer):
        for group in groups.get((dim, entity), []):
            # as for other formats: one nameless number on all solids, or any on lines, says nothing
            if dim == 2 or dim in named or (dim == 3 and len(used[dim]) > 1):
                name = names.get((dim, group), str(group))
                raw.cell_sets.setdefault(name, []).append((len(raw.blocks), np.arange(len(rows))))
        raw.blocks.append((kind, index(rows)))
    return raw


def _entities(section: Numbers, groups: Groups, newer: bool) -> None:
    counts = section.longs(4).tolist()
    for dim, count in enumerate(counts):
        for _ in range(count):
            number = int(section.ints(1)[0])
            section.floats(3 if dim == 0 and newer else 6)
            groups[dim, number] = _tags(section)
            if dim:
                section.ints(int(section.longs(1)[0]))  # what bounds it


def _partitioned(section: Numbers, groups: Groups, newer: bool) -> None:
    """Entities that Gmsh has cut for parallel computing: they carry their parents' groups."""
    section.longs(1)
    section.ints(2 * int(section.longs(1)[0]))  # ghost entities
    counts = section.longs(4).tolist()
    for dim, count in enumerate(counts):
        for _ in range(count):
            number, parent_dim, parent = section.ints(3).tolist()
            section.ints(int(section.longs(1)[0]))  # partitions
            section.floats(3 if dim == 0 and newer else 6)
            own = _tags(section)
            groups[dim, number] = own or (groups.get((dim, parent), []) if parent_dim == dim else [])
            if dim:
                section.ints(int(section.longs(1)[0]))


def _tags(section: Numbers) -> list[int]:
    numbers: list[int] = np.abs(section.ints(int(section.longs(1)[0]))).tolist()
    return numbers


def _nodes(section: Numbers, newer: bool) -> tuple[Ints, Floats]:
    """Numbers (n,) and places (n, 3) of all nodes; coordinates on their curve or surface are passed over."""
    blocks = int(section.longs(4 if newer else 2)[0])
    numbers, points = [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    for _ in range(blocks):
        first, second, parametric = section.ints(3).tolist()
        count = int(section.longs(1)[0])
        width = 3 + (first if newer else second) * parametric
        if newer:
            numbers.append(section.longs(count))
            points.append(section.floats(count * width).reshape(count, width)[:, :3])
        elif section.binary:
            table = section.records(count, [("number", "i4"), ("place", "f8", width)])
            numbers.append(table["number"].astype(np.int64))
            points.append(table["place"].reshape(count, width)[:, :3])
        else:
            rows = section.floats(count * (1 + width)).reshape(count, 1 + width)
            numbers.append(rows[:, 0].astype(np.int64))
            points.append(rows[:, 1:4])
    return np.concatenate(numbers), np.concatenate(points)


def _elements(section: Numbers, newer: bool) -> list[tuple[int, int, str, Ints]]:
    """Dimension and number of the entity, kind and nodes of each block of elements."""
    made = []
    for _ in range(int(section.longs(4 if newer else 2)[0])):
        first, second, number = section.ints(3).tolist()
        dim, entity = (first, second) if newer else (second, first)
        count = int(section.longs(1)[0])
        kind, nodes = kind_and_nodes(number)
        flat = (section.longs if newer else section.ints)(count * (1 + nodes))
        made.append((dim, entity, kind, flat.reshape(count, 1 + nodes)[:, 1:]))
    return made
