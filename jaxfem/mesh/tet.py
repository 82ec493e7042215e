"""The tetrahedral mesh: nodes, elements and named groups, checked once when it is made. Lives on the host."""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from . import checks, named
from .checks import Floats, Ints, MeshError
from .named import Groups
from .topology import boundary_faces, unique_edges

__all__ = ["MeshError", "TetMesh"]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class TetMesh:
    """Nodes and linear tetrahedra with named groups; the arrays are copies and read-only.

    points (n, 3) in m, cells (m, 4) node numbers; face_groups name -> (k, 3) node numbers, turned outward;
    node_groups and cell_groups name -> (k,) numbers or a boolean mask. Elements that are oriented inside out have their
    last two nodes swapped, which `notes` records. MeshError names the node or element for anything else that is wrong:
    coordinates that are not finite, node numbers out of range, a repeated node, a flat or duplicate element, a node
    without an element.
    """

    points: Floats
    cells: Ints
    name: str = "mesh"
    face_groups: Groups = dataclasses.field(default_factory=dict)
    node_groups: Groups = dataclasses.field(default_factory=dict)
    cell_groups: Groups = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        points = checks.as_points(self.points, self.name)
        cells = checks.as_cells(self.cells, len(points), self.name)
        checks.refuse_bad_elements(points, cells, self.name)
        cells, notes = checks.flipped(points, cells)
        made: dict[str, Any] = {
            "points": points,
            "cells": cells,
            "face_groups": named.checked_faces(self.face_groups, cells, self.name),
            "node_groups": named.checked_numbers(self.node_groups, len(points), "node", self.name),
            "cell_groups": named.checked_numbers(self.cell_groups, len(cells), "cell", self.name),
            "notes": tuple(self.notes) + notes,
        }
        for array in [
            points,
            cells,
            *(a for value in made.values() if isinstance(value, dict) for a in value.values()),
        ]:
            array.flags.writeable = False  # cached properties and groups would go stale
        for key, value in made.items():
            object.__setattr__(self, key, value)

    @classmethod
    def repaired(
        cls,
        points: Any,
        cells: Any,
        name: str = "mesh",
        face_groups: Mapping[str, Any] | None = None,
        node_groups: Mapping[str, Any] | None = None,
        cell_groups: Mapping[str, Any] | None = None,
        notes: tuple[str, ...] = (),
    ) -> "TetMesh":
        """A mesh from parts that need not be clean: what a TetMesh refuses is dropped, and `notes` says what.

        Dropped are elements that name a node twice, are flat, or are there twice, then nodes that no element uses;
        groups are renumbered. Element and node numbers in the notes are those of the input. Coincident nodes stay
        apart: `merged` joins them. MeshError for what has no repair (shapes, NaN, unknown nodes).
        """
        from .repair import cleaned

        return cls(*cleaned(points, cells, name, face_groups or {}, node_groups or {}, cell_groups or {}, notes))

    def merged(self, distance: float = 0.0) -> "TetMesh":
        """The mesh with nodes at most `distance` [m] apart made one (0: those within rounding); `notes` says how many.

        Groups follow; elements that lose their volume by it are dropped, as `repaired` does.
        """
        from .seams import merged_nodes

        return merged_nodes(self, distance)

    def __repr__(self) -> str:
        nodes, elements = len(self.points), len(self.cells)
        return f'TetMesh("{self.name}", {nodes} nodes, {elements} elements, {self.volume:.4g} m^3)'

    @cached_property
    def volumes(self) -> Floats:
        """Volume of each element (m,), m^3, all positive."""
        return checks.signed_volumes(self.points, self.cells)

    @property
    def volume(self) -> float:
        """Volume of the whole mesh, m^3."""
        return float(self.volumes.sum())

    @cached_property
    def surface(self) -> Ints:
        """Triangles that belong to one element only (k, 3), their nodes counter-clockwise seen from outside."""
        return boundary_faces(self.cells)[0]

    @cached_property
    def surface_nodes(self) -> Ints:
        """Numbers of the nodes on the surface, sorted (k,)."""
        return np.unique(self.surface)

    @cached_property
    def edges(self) -> Ints:
        """Every edge once, as sorted node pairs (e, 2)."""
        return unique_edges(self.cells)

    @property
    def bounds(self) -> Floats:
        """Smallest and largest x, y, z (2, 3), m."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])

    def faces(self, name: str) -> Ints:
        """Triangles (k, 3) of a face group, turned outward; "surface" is the whole surface unless a group is so named.

        MeshError for a name that does not exist.
        """
        if name in self.face_groups:
            return self.face_groups[name]
        if name == "surface":
            return self.surface
        raise MeshError(self._unknown("face", name, [*self.face_groups, "surface"]))

    def nodes(self, name: str) -> Ints:
        """Sorted node numbers (k,) of a node group, or else the nodes of the face or cell group of that name.

        "all" are all nodes, and "surface" those of the surface, unless a group is so named.

        MeshError for a name that does not exist.
        """
        if name in self.node_groups:
            return self.node_groups[name]
        if name in self.face_groups or name == "surface":
            return np.unique(self.faces(name))
        if name in self.cell_groups:
            return np.unique(self.cells[self.cell_groups[name]])
        if name == "all":
            return np.arange(len(self.points))
        raise MeshError(
            self._unknown("node", name, [*self.node_groups, *self.face_groups, *self.cell_groups, "surface", "all"])
        )

    def _unknown(self, kind: str, name: str, known: list[str]) -> str:
        names = ", ".join(dict.fromkeys(f'"{each}"' for each in known))
        return f'no {kind} group "{name}" in "{self.name}": it has {names}'

    def scaled(self, factor: float) -> "TetMesh":
        """The mesh with every coordinate multiplied by a positive factor (1e-3 takes mm to m)."""
        if not checks.is_positive(factor):
            raise MeshError(f'scale factor {factor!r} for "{self.name}": give one positive number')
        return dataclasses.replace(self, points=self.points * factor)

    def translated(self, offset: Any) -> "TetMesh":
        """The mesh moved by offset (3,), m."""
        checks.refuse_traced(offset, f'offset for "{self.name}"')
        shift = np.asarray(offset, dtype=np.float64)
        if shift.shape != (3,):
            raise MeshError(f'offset of shape {shift.shape} for "{self.name}": give three numbers')
        return dataclasses.replace(self, points=self.points + shift)

    def rotated(self, matrix: Any) -> "TetMesh":
        """The mesh turned about the origin by a rotation matrix (3, 3); MeshError for any other matrix."""
        checks.refuse_traced(matrix, f'the matrix to rotate "{self.name}"')
        turn = np.asarray(matrix, dtype=np.float64)
        if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
            raise MeshError(
                f'the matrix given to rotate "{self.name}" is no rotation: its rows must be orthonormal, det +1'
            )
        return dataclasses.replace(self, points=self.points @ turn.T)

    def renamed(self, name: str) -> "TetMesh":
        """The same mesh under another name, the one that messages use."""
        return dataclasses.replace(self, name=name)
