"""How good a mesh is: sizes, angles, shapes and whether its surface is closed, as numbers and as text."""

import dataclasses
import os

import numpy as np

from .checks import Floats, Ints, edge_lengths, listed, signed_volumes
from .tet import TetMesh
from .topology import components, dihedral_angles, element_faces, face_counts, triangle_edge_counts
from .troubles import coincident, troubles

WORST = 5  # elements named in the report


@dataclasses.dataclass(frozen=True)
class QualityReport:
    """Figures of one mesh: lengths in m, areas in m^2, volumes in m^3, angles in degrees.

    shape is three times inscribed over circumscribed radius: 1 for a regular tetrahedron, 0 for a flat one; worst holds
    the numbers of the elements with the smallest. closed_surface: two triangles meet at every surface edge, so nothing
    hangs together by an edge alone. coincident_nodes lie on top of another node; shared_too_often counts faces of more
    than two elements (elements that overlap). troubles: what `build` warns of too.
    """

    name: str
    nodes: int
    elements: int
    components: int
    size: tuple[float, float, float]
    volume: float
    min_volume: float
    max_volume: float
    min_dihedral: float
    max_dihedral: float
    min_shape: float
    mean_shape: float
    worst: tuple[int, ...]
    min_edge: float
    max_edge: float
    surface_triangles: int
    surface_area: float
    closed_surface: bool
    coincident_nodes: int
    shared_too_often: int
    troubles: tuple[str, ...]
    face_groups: dict[str, int]
    node_groups: dict[str, int]
    cell_groups: dict[str, int]
    notes: tuple[str, ...]

    def text(self) -> str:
        """The report for a terminal, warnings last."""
        rows = [
            ("nodes", f"{self.nodes}"),
            ("elements", f"{self.elements}" + (f" in {self.components} separate parts" if self.components > 1 else "")),
            ("size", " x ".join(f"{length:.4g}" for length in self.size) + " m"),
            ("volume", f"{self.volume:.5g} m^3 (an element {self.min_volume:.3g} to {self.max_volume:.3g})"),
            ("edges", f"{self.min_edge:.3g} to {self.max_edge:.3g} m"),
            ("surface", f"{self.surface_triangles} triangles, {self.surface_area:.5g} m^2"),
            ("dihedral angles", f"{self.min_dihedral:.1f} to {self.max_dihedral:.1f} degrees (regular: 70.5)"),
            ("shape", f"worst {self.min_shape:.3f}, mean {self.mean_shape:.3f} (regular: 1, flat: 0)"),
            ("worst elements", listed(self.worst)),
        ]
        for kind, groups in (("face", self.face_groups), ("node", self.node_groups), ("cell", self.cell_groups)):
            if groups:
                rows.append((f"{kind} groups", ", ".join(f"{name} ({count})" for name, count in groups.items())))
        lines = [f'mesh "{self.name}"', *(f"  {label:<16}{value}" for label, value in rows)]
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines + [f"  warning: {warning}" for warning in self.warnings()])

    def warnings(self) -> tuple[str, ...]:
        """What may spoil a simulation on this mesh, one sentence each; empty for a good one."""
        found = list(self.troubles)
        if not self.closed_surface:
            found.append("parts of the mesh hang together by an edge alone, or faces inside do not match")
        if self.shared_too_often:
            found.append(f"{self.shared_too_often} faces belong to more than two elements: elements overlap")
        return tuple(found)


def quality(mesh: TetMesh) -> QualityReport:
    """Measure a mesh; see QualityReport for the figures."""
    shape = shapes(mesh.points, mesh.cells)
    angles = dihedral_angles(mesh.points, mesh.cells)
    lengths = edge_lengths(mesh.points, mesh.cells)
    size = np.ptp(mesh.points, axis=0)
    return QualityReport(
        name=mesh.name,
        nodes=len(mesh.points),
        elements=len(mesh.cells),
        components=components(mesh.cells, len(mesh.points)),
        size=(float(size[0]), float(size[1]), float(size[2])),
        volume=mesh.volume,
        min_volume=float(mesh.volumes.min()),
        max_volume=float(mesh.volumes.max()),
        min_dihedral=float(angles.min()),
        max_dihedral=float(angles.max()),
        min_shape=float(shape.min()),
        mean_shape=float(shape.mean()),
        worst=tuple(int(number) for number in np.argsort(shape, kind="stable")[:WORST]),
        min_edge=float(lengths.min()),
        max_edge=float(lengths.max()),
        surface_triangles=len(mesh.surface),
        surface_area=float(_areas(mesh.points, mesh.surface).sum()),
        closed_surface=bool((triangle_edge_counts(mesh.surface) == 2).all()),
        coincident_nodes=coincident(mesh.points, float(lengths.min())),
        shared_too_often=int((np.unique(face_counts(element_faces(mesh.cells))[0], return_counts=True)[1] > 2).sum()),
        troubles=troubles(mesh),
        face_groups={name: len(faces) for name, faces in mesh.face_groups.items()},
        node_groups={name: len(nodes) for name, nodes in mesh.node_groups.items()},
        cell_groups={name: len(cells) for name, cells in mesh.cell_groups.items()},
        notes=mesh.notes,
    )


def report_text(path: str | os.PathLike[str], scale: float | None = None, *, merge: bool | float = False) -> str:
    """The report on a mesh file for a terminal; errors as for `read`."""
    from .files import read

    return quality(read(path, scale=scale, merge=merge)).text()


def shapes(points: Floats, cells: Ints) -> Floats:
    """Three times the inscribed over the circumscribed radius of each element (m,): 1 regular, 0 flat."""
    volumes = np.abs(signed_volumes(points, cells))
    inscribed = 3.0 * volumes / _areas(points, element_faces(cells)).reshape(-1, 4).sum(axis=1)
    edges = edge_lengths(points, cells)
    # with p, q, r the products of opposite edges: 24 V R = sqrt((p+q+r)(p+q-r)(p-q+r)(-p+q+r))
    p, q, r = (edges[:, i] * edges[:, 5 - i] for i in range(3))
    product = (p + q + r) * (p + q - r) * (p - q + r) * (-p + q + r)
    found: Floats = 72.0 * volumes * inscribed / np.sqrt(np.maximum(product, np.finfo(float).tiny))
    return found


def _areas(points: Floats, triangles: Ints) -> Floats:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    areas: Floats = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return areas
