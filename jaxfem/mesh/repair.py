"""Dropping the parts of a mesh that cannot be used, with a note for each kind."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from . import checks, named
from .checks import Floats, Ints, MeshError, counted, listed

Cleaned = tuple[Floats, Ints, str, named.Groups, named.Groups, named.Groups, tuple[str, ...]]


def cleaned(
    points: Any,
    cells: Any,
    name: str,
    face_groups: Mapping[str, Any],
    node_groups: Mapping[str, Any],
    cell_groups: Mapping[str, Any],
    notes: tuple[str, ...],
) -> Cleaned:
    """The arguments of a TetMesh without what it would refuse; `notes` grows by one line a kind of repair."""
    points = checks.as_points(points, name)
    cells = checks.as_cells(cells, len(points), name)
    keep, dropped_elements = _usable_elements(points, cells)
    if not len(keep):
        raise MeshError(
            f'no usable element is left of "{name}" ({"; ".join(dropped_elements)}): check the scale and format'
        )
    kept_cells, flips = checks.flipped(points, cells[keep], numbers=keep)
    idle = checks.unreferenced(len(points), kept_cells)
    nodes = np.setdiff1d(np.arange(len(points)), idle)
    new = np.full(len(points), -1, dtype=np.int64)
    new[nodes] = np.arange(len(nodes))
    kept_cells = new[kept_cells]
    first = checks.first_equal(cells)  # an element that is there twice belongs to the groups of both
    by_number = named.checked_numbers(cell_groups, len(cells), "cell", name)
    faces, dropped_faces = named.renumbered_faces(face_groups, nodes, len(points), kept_cells, name)
    dropped_nodes = _note(idle, "node", "without an element")
    return (
        points[nodes],
        kept_cells,
        name,
        faces,
        named.renumbered(node_groups, nodes, len(points), "node", name),
        named.renumbered({key: first[own] for key, own in by_number.items()}, keep, len(cells), "cell", name),
        (*notes, *dropped_elements, *flips, *dropped_nodes, *dropped_faces),
    )


def _usable_elements(points: Floats, cells: Ints) -> tuple[Ints, tuple[str, ...]]:
    """Numbers of the elements to keep, and the notes about the others."""
    repeated = checks.repeated_nodes(cells)
    flat = checks.degenerate(points, cells) & ~repeated
    twice = (checks.first_equal(cells) != np.arange(len(cells))) & ~repeated & ~flat
    notes = (
        *_note(np.flatnonzero(repeated), "element", "naming a node twice"),
        *_note(np.flatnonzero(flat), "element", "without volume"),
        *_note(np.flatnonzero(twice), "element", "with the nodes of an earlier one"),
    )
    return np.flatnonzero(~(repeated | flat | twice)), notes


def _note(numbers: Ints, noun: str, why: str) -> tuple[str, ...]:
    if not len(numbers):
        return ()
    return (f"{counted(len(numbers), noun)} {why} {'was' if len(numbers) == 1 else 'were'} dropped: {listed(numbers)}",)
