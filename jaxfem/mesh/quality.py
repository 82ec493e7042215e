"""How good a mesh is: sizes, angles, shapes and whether its surface is closed, as numbers and as text."""

import dataclasses
import os

import numpy as np

from .checks import Floats, Ints, edge_lengths, listed, signed_volumes
from .tet import TetMesh
from .topology import components, element_faces, face_counts, triangle_edge_counts

WORST = 5  # elements named in the report
POOR_ANGLE = 5.0  # degrees


@dataclasses.dataclass(frozen=True)
class QualityReport:
    """Figures of one mesh: lengths in m, areas in m^2, volumes in m^3, angles in degrees.

    shape is three times inscribed over circumscribed radius: 1 for a regular tetrahedron, 0 for a flat one; worst holds
    the numbers of the elements with the smallest. closed_surface: two triangles meet at every surface edge, so nothing
    hangs together by an edge alone. coincident_nodes lie on top of another node; shared_too_often counts faces of more
    than two elements (elements that overlap).
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
        found = []
        if self.min_dihedral < POOR_ANGLE:
            found.append(
                f"element {self.worst[0]} is nearly flat (smallest angle {self.min_dihedral:.2g} degrees): remesh"
            )
        if self.components > 1:
            found.append(f"the mesh falls into {self.components} parts that share no node")
        if not self.closed_surface:
            found.append("parts of the mesh hang together by an edge alone, or faces inside do not match")
        if self.coincident_nodes:
            found.append(
                f"{self.coincident_nodes} nodes lie on top of another: merge them if the parts are meant to join"
            )
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
        coincident_nodes=_coincident(mesh.points),
        shared_too_often=int((np.unique(face_counts(element_faces(mesh.cells))[0], return_counts=True)[1] > 2).sum()),
        face_groups={name: len(faces) for name, faces in mesh.face_groups.items()},
        node_groups={name: len(nodes) for name, nodes in mesh.node_groups.items()},
        cell_groups={name: len(cells) for name, cells in mesh.cell_groups.items()},
        notes=mesh.notes,
    )


def report_text(path: str | os.PathLike[str], scale: float = 1.0) -> str:
    """The report on a mesh file for a terminal; errors as for `read`."""
    from .files import read

    return quality(read(path, scale=scale)).text()


def dihedral_angles(points: Floats, cells: Ints) -> Floats:
    """The six angles (m, 6) between the faces of each element, in degrees."""
    corners = points[element_faces(cells)].reshape(len(cells), 4, 3, 3)
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    first, second = np.triu_indices(4, 1)
    cosines = -np.einsum("mpi,mpi->mp", normals[:, first], normals[:, second])  # both normals point outward
    angles: Floats = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    return angles


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


def _coincident(points: Floats) -> int:
    """Nodes that have another within rounding of the mesh's size."""
    from scipy.spatial import cKDTree  # slow to import: only where it is used

    limit = 1e-12 * float(np.linalg.norm(np.ptp(points, axis=0)))
    return int((cKDTree(points).query(points, k=2)[0][:, 1] <= limit).sum())
