"""Gmsh's files (.msh) of versions 1, 2 and 4, as text or binary, with elements in one physical group, several or none.

The formats: Gmsh manual, "MSH file format" and its legacy sections, https://gmsh.info/doc/texinfo/gmsh.html
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..checks import Ints, MeshError, first_equal
from ..raw import RawMesh, sets_of_tags
from .gmsh4 import read_4
from .gmsh_types import kind_and_nodes
from .numbers import Numbers, node_index

BINARY = ("Nodes", "ParametricNodes", "Elements", "Entities", "PartitionedEntities")
Names = dict[tuple[int, int], str]


def read_gmsh(path: Path) -> RawMesh:
    """All elements of the file, and its physical groups as sets."""
    content = path.read_bytes()
    if re.match(rb"\s*\$NOD\b", content):
        text = dict(_sections(content, Numbers(b"", False)))
        return _two(text["NOD"], text["ELM"], {}, 1.0)
    head = re.search(rb"\$MeshFormat\s+([\d.]+)\s+(\d)\s+(\d+)[^\n]*\n", content)
    if head is None:
        raise MeshError("it has no $MeshFormat")
    version, binary, width = float(head[1]), head[2] == b"1", int(head[3])
    swapped = binary and content[head.end() : head.end() + 4] == b"\x00\x00\x00\x01"
    sections = dict(_sections(content, Numbers(b"", binary, swapped, width)))
    names = _names(sections.get("PhysicalNames"))
    if "ParametricNodes" in sections:
        sections["Nodes"] = _plain(sections["ParametricNodes"])
    if "Nodes" not in sections or "Elements" not in sections:
        raise MeshError("it has no $Nodes with $Elements")
    if version >= 4:
        return read_4(sections, names, version)
    return _two(sections["Nodes"], sections["Elements"], names, version)


def _sections(content: bytes, style: Numbers) -> Iterator[tuple[str, Numbers]]:
    """Name and numbers of each section. Binary numbers may look like anything: a section ends at its own $End."""
    place = 0
    while found := re.compile(rb"(?:\A|\n)?\$(\w+)[ \t\r]*\n").search(content, place):
        name = found[1].decode()
        end = content.find(b"$End" + found[1], found.end())
        if end < 0:
            # the first version has $ENDNOD, $ENDELM
            end = content.find(b"$END" + found[1], found.end())
        if end < 0:
            raise MeshError(f"its section ${name} does not end: the file is cut short")
        binary = style.binary and name in BINARY
        yield name, Numbers(content[found.end() : end], binary, style.swapped, style.width)
        place = end + 4 + len(name)


def _names(section: Numbers | None) -> Names:
    """(dimension, number) -> name of the physical groups."""
    if section is None:
        return {}
    rows = re.findall(rb'^\s*(\d+)\s+(-?\d+)\s+"(.*)"', section.content, re.MULTILINE)
    return {(int(dim), abs(int(number))): name.decode(errors="replace") for dim, number, name in rows}


def _two(nodes: Numbers, elements: Numbers, names: Names, version: float) -> RawMesh:
    """Versions 1 and 2. An element in several groups is there several times, once with the number of each."""
    nodes = nodes if nodes.binary else _plain(nodes)
    count = nodes.count()
    if nodes.binary:
        table = nodes.records(count, [("number", "i4"), ("place", "f8", 3)])
        numbers, points = table["number"].astype(np.int64), table["place"]
    else:
        rows = nodes.floats(4 * count).reshape(-1, 4)
        numbers, points = rows[:, 0].astype(np.int64), rows[:, 1:]
    found: dict[str, list[tuple[Ints, Ints]]] = {}
    for kind, group, own in _elements_binary(elements) if elements.binary else _elements(elements, version):
        found.setdefault(kind, []).append((group, own))
    index = node_index(numbers)
    blocks, tags = [], []
    for kind, parts in found.items():
        groups, rows = (np.concatenate(each) for each in zip(*parts, strict=True))
        blocks.append((kind, index(rows)))
        tags.append(groups)
    sets = sets_of_tags(blocks, tags, names)
    return _once(RawMesh(points, blocks, sets))


def _plain(section: Numbers) -> Numbers:
    """Nodes without their coordinates on curves and surfaces, which older versions write after the place."""
    if section.binary:
        raise MeshError("its nodes are parametric and binary: save it without Mesh.SaveParametric, or as version 4.1")
    lines = section.content.splitlines()
    return Numbers(b"\n".join(lines[:1] + [b" ".join(line.split()[:4]) for line in lines[1:]]), False)


def _elements(section: Numbers, version: float) -> Iterator[tuple[str, Ints, Ints]]:
    """Kind, physical group and nodes of the elements of a text file, a kind at a time."""
    count = section.count()
    rows: dict[tuple[int, int], list[list[int]]] = {}
    for line in section.lines(count):
        # version 1: number, type, group, entity, count of nodes; version 2: number, type, count of tags, tags
        head, group = (5, line[2]) if version < 2 else (3 + line[2], line[3] if line[2] else 0)
        rows.setdefault((line[1], head), []).append([group, *line[head:]])
    for (number, _), same in rows.items():
        kind, nodes = kind_and_nodes(number)
        if any(len(row) != nodes + 1 for row in same):
            raise MeshError(f"an element of kind {kind} in it has not {nodes} nodes")
        table = np.array(same, dtype=np.int64)
        yield kind, np.abs(table[:, 0]), table[:, 1:]


def _elements_binary(section: Numbers) -> Iterator[tuple[str, Ints, Ints]]:
    """The same of a binary file, where elements follow in runs of one type."""
    left = section.count()
    while left > 0:
        number, count, tags = (int(each) for each in section.ints(3))
        kind, nodes = kind_and_nodes(number)
        table = section.ints(count * (1 + tags + nodes)).reshape(count, -1)
        groups = np.abs(table[:, 1]) if tags else np.zeros(count, np.int64)
        yield kind, groups, table[:, 1 + tags :]
        left -= count


def _once(raw: RawMesh) -> RawMesh:
    """Elements that are there once for each of their groups made one, which is in all of them."""
    grouped = [np.zeros(len(rows), dtype=bool) for _, rows in raw.blocks]
    for block, chosen in (each for members in raw.cell_sets.values() for each in members):
        grouped[block][chosen] = True
    places: list[Ints] = []  # of each element: where it, or the first with its nodes, is now
    for i, (kind, rows) in enumerate(raw.blocks):
        first, own = first_equal(rows), np.arange(len(rows))
        # without a group, a second element with the same nodes is a fault of the file, which is told later
        copy = (first != own) & grouped[i]
        places.append((np.cumsum(~copy) - 1)[np.where(copy, first, own)])
        raw.blocks[i] = (kind, rows[~copy])
    raw.cell_sets = {
        name: [(i, np.unique(places[i][chosen])) for i, chosen in members] for name, members in raw.cell_sets.items()
    }
    return raw
