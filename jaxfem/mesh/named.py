"""Named groups of faces, nodes and elements: checked when a mesh is made, renumbered when parts of it are dropped."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .checks import Ints, MeshError, as_integers, listed
from .topology import element_faces, oriented_like

Groups = dict[str, Ints]


def checked_numbers(groups: Mapping[str, Any], count: int, kind: str, name: str) -> Groups:
    """Groups of node or element numbers, each sorted and once; boolean masks (count,) are taken too."""
    return {str(key): _numbers(values, count, f'{kind} group "{key}" of "{name}"') for key, values in groups.items()}


def _numbers(values: Any, count: int, what: str) -> Ints:
    array = np.asarray(values)
    if array.dtype == bool:
        if array.shape != (count,):
            raise MeshError(f"{what} is a mask of shape {array.shape}: give ({count},), or a list of numbers")
        array = np.flatnonzero(array)
    numbers = np.unique(as_integers(array, f"numbers in {what}"))
    if len(numbers) and (numbers[0] < 0 or numbers[-1] >= count):
        wrong = numbers[0] if numbers[0] < 0 else numbers[-1]
        raise MeshError(f"{what} holds number {wrong}: numbers run from 0 to {count - 1}")
    return numbers


def checked_faces(groups: Mapping[str, Any], cells: Ints, name: str) -> Groups:
    """Groups of triangles (k, 3), each a face of some element and turned outward; MeshError names one that is not."""
    faces = {str(key): _triangles(values, f'face group "{key}" of "{name}"') for key, values in groups.items()}
    made, missing = _oriented(faces, cells)
    for key, numbers in missing.items():
        if len(numbers):
            nodes = listed(faces[key][numbers[0]])
            raise MeshError(
                f'triangle {numbers[0]} of face group "{key}" of "{name}" is not a face of any element (nodes {nodes}):'
                " leave it out"
            )
    return made


def _oriented(groups: Groups, cells: Ints) -> tuple[Groups, Groups]:
    """Each group's triangles turned outward, and the numbers of those that no element has: all groups in one search."""
    if not groups:
        return {}, {}
    turned, missing = oriented_like(np.concatenate(list(groups.values())), element_faces(cells))
    ends = np.cumsum([len(faces) for faces in groups.values()])
    starts = ends - [len(faces) for faces in groups.values()]
    made = {name: turned[a:b] for name, a, b in zip(groups, starts, ends, strict=True)}
    lost = {name: missing[(missing >= a) & (missing < b)] - a for name, a, b in zip(groups, starts, ends, strict=True)}
    return made, lost


def _triangles(values: Any, what: str) -> Ints:
    faces = as_integers(values, f"node numbers in {what}")
    if faces.size and (faces.ndim != 2 or faces.shape[1] != 3):
        raise MeshError(f"{what} has shape {faces.shape}: give (k, 3), three node numbers a triangle")
    return faces.reshape(-1, 3)


def renumbered(groups: Mapping[str, Any], kept: Ints, count: int, kind: str, name: str) -> Groups:
    """Groups of numbers below `count`, after only the numbers in `kept` stayed and were counted afresh."""
    new = np.full(count, -1, dtype=np.int64)
    new[kept] = np.arange(len(kept))
    moved = {key: new[numbers] for key, numbers in checked_numbers(groups, count, kind, name).items()}
    return {key: numbers[numbers >= 0] for key, numbers in moved.items()}


def renumbered_faces(
    groups: Mapping[str, Any], kept: Ints, count: int, cells: Ints, name: str
) -> tuple[Groups, tuple[str, ...]]:
    """Groups of triangles, after only the nodes in `kept` stayed; those no element has are dropped with a note."""
    new = np.full(count, -1, dtype=np.int64)
    new[kept] = np.arange(len(kept))
    moved: Groups = {}
    for key, values in groups.items():
        old = _triangles(values, f'face group "{key}" of "{name}"')
        if len(old) and (old.min() < 0 or old.max() >= count):
            raise MeshError(
                f'face group "{key}" of "{name}" uses a node that does not exist: nodes are 0 to {count - 1}'
            )
        moved[str(key)] = new[old]
    missing = _oriented(moved, cells)[1]
    notes = [
        f'face group "{key}": {len(lost)} of {len(moved[key])} triangles are no face of any element; left out'
        for key, lost in missing.items()
        if len(lost)
    ]
    return {key: np.delete(faces, missing[key], axis=0) for key, faces in moved.items()}, tuple(notes)
