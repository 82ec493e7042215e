"""Meshes of convex bodies from a cloud of points or a closed surface, by Delaunay's rule."""

from typing import TYPE_CHECKING, Any

import numpy as np

from . import checks
from .checks import Floats, Ints, Mask, MeshError, counted, first_equal
from .tet import TetMesh
from .topology import element_faces, face_counts, triangle_edge_counts

if TYPE_CHECKING:  # slow to import: each function that needs it does so itself
    from scipy.spatial import ConvexHull

FLAT = 1e-10  # as THIN, for elements whose volume is rounding
THIN = 1e-3  # a tetrahedron on the hull with |volume| below THIN * longest_edge**3 (regular: 0.118) is a sliver
CONVEX = 1e-3  # a surface counts as convex when its hull encloses at most this share more
MOST_POINTS = 2_000_000


def delaunay(points: Any, name: str = "cloud") -> TetMesh:
    """The Delaunay tetrahedra of a point cloud (n, 3), m: they fill its convex hull.

    Slivers lying flat on the hull are peeled off, and the difference from the hull's volume stands in `notes`, as do
    points left out because they coincide with another. MeshError for fewer than four points, or points in one plane.
    """
    cloud = checks.as_points(points, name)
    hull = _hull(cloud, name)
    cells = _peeled(cloud, _tetrahedra(cloud))
    if _has_gaps(cloud, cells, hull.volume):
        cells = _peeled(cloud, _generic_tetrahedra(cloud))
    if _has_gaps(cloud, cells, hull.volume):
        raise MeshError(
            f'the points of "{name}" leave flat elements: move points that lie on one plane or sphere apart'
        )
    mesh = TetMesh.repaired(cloud, cells, name)
    short = hull.volume - mesh.volume
    if abs(short) <= 1e-9 * hull.volume:
        return mesh
    note = (
        f"slivers on the hull were peeled off: the mesh is {short:.3g} m^3 "
        f"({short / hull.volume:.2g} of it) short of the hull"
    )
    return TetMesh(mesh.points, mesh.cells, name, notes=(*mesh.notes, note))


def from_convex_surface(points: Any, triangles: Any, spacing: float | None = None, name: str = "body") -> TetMesh:
    """Tetrahedra inside a closed convex surface: points (n, 3) in m, triangles (k, 3), either way round.

    Nodes are added inside on a body-centred lattice with about `spacing` (m) between neighbours; by default the
    surface's mean edge length. MeshError for a surface that is open or not convex, or a spacing that is not positive.
    """
    cloud = checks.as_points(points, name)
    faces = checks.as_triangles(triangles, len(cloud), name)
    used, faces = np.unique(faces, return_inverse=True)
    cloud, faces = cloud[used], faces.reshape(-1, 3)
    hull = _hull(cloud, name)
    _refuse_open_or_hollow(cloud, faces, hull, name)
    if spacing is None:
        ends = cloud[faces]
        spacing = float(np.linalg.norm(ends - np.roll(ends, 1, axis=1), axis=-1).mean())
    if not checks.is_positive(spacing):
        raise MeshError(f'spacing={spacing!r} for "{name}": give a positive length in m')
    return delaunay(np.concatenate([cloud, _lattice_inside(cloud, hull, spacing, name)]), name)


def _hull(cloud: Floats, name: str) -> "ConvexHull":
    from scipy.spatial import ConvexHull, QhullError

    try:
        return ConvexHull(cloud)
    except QhullError as problem:
        reason = "fewer than four points" if len(cloud) < 4 else "points (nearly) in one plane"
        raise MeshError(f'the points of "{name}" have no volume: {reason}') from problem


def _tetrahedra(cloud: Floats) -> Ints:
    from scipy.spatial import Delaunay

    return checks.flipped(cloud, Delaunay(cloud - cloud.mean(axis=0)).simplices.astype(np.int64))[0]


def _peeled(cloud: Floats, cells: Ints) -> Ints:
    """Without the flat elements and the slivers that lie on the hull, layer after layer."""
    while True:
        alone = (face_counts(element_faces(cells))[1] == 1).reshape(-1, 4)
        flat = _thin(cloud, cells, FLAT) & alone.any(axis=1)
        sliver = _thin(cloud, cells, THIN) & (alone.sum(axis=1) == 2) & ~flat
        drop = flat if flat.any() else _lids(cells, alone, np.flatnonzero(sliver))
        if not drop.any():
            return cells
        cells = cells[~drop]


def _lids(cells: Ints, alone: Mask, slivers: Ints) -> Mask:
    """Which elements can go without pinching the surface: the edge they uncover must be new to it, and differ."""
    uncovered = cells[slivers][alone[slivers]].reshape(
        -1, 2
    )  # face i is opposite node i: the other two join the outer faces
    triangles = element_faces(cells)[alone.ravel()]
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    first = first_equal(np.concatenate([edges, uncovered]))[len(edges) :]
    drop = np.zeros(len(cells), dtype=bool)
    drop[slivers[first == len(edges) + np.arange(len(slivers))]] = True
    return drop


def _thin(cloud: Floats, cells: Ints, limit: float) -> Mask:
    size = checks.edge_lengths(cloud, cells).max(axis=1) ** 3
    thin: Mask = np.abs(checks.signed_volumes(cloud, cells)) <= limit * size
    return thin


def _has_gaps(cloud: Floats, cells: Ints, volume: float) -> bool:
    """Whether flat elements stay inside, or the outer triangles do not make one simple closed surface."""
    if _thin(cloud, cells, FLAT).any():
        return True
    faces = element_faces(cells)
    outside = faces[face_counts(faces)[1] == 1]
    filled = np.abs(checks.signed_volumes(cloud, cells)).sum()
    return bool((triangle_edge_counts(outside) != 2).any() or abs(filled - volume) > 0.05 * volume)


def _generic_tetrahedra(cloud: Floats) -> Ints:
    """Tetrahedra of a cloud with many points on one sphere, where Delaunay's rule leaves the choice open.

    The Delaunay cells are the lower hull of the points lifted to (x, |x|^2). Lifted a little more, each by a random
    amount (the same every time), no five are on one sphere any more, and the cells match and have volume.
    """
    from scipy.spatial import ConvexHull, cKDTree

    local = (cloud - cloud.mean(axis=0)) / np.ptp(cloud, axis=0).max()
    apart = cKDTree(local).query(local, k=2)[0][:, 1]
    lift = np.random.default_rng(0).uniform(0.0, 1e-3, len(local)) * apart**2
    hull = ConvexHull(np.column_stack([local, (local**2).sum(axis=1) + lift]))
    cells = hull.simplices[hull.equations[:, 3] < -1e-9].astype(np.int64)
    return checks.flipped(cloud, cells)[0]


def _depth(queries: Floats, hull: "ConvexHull") -> Floats:
    """Distance (q,) of points to the nearest plane of the hull, positive inside."""
    planes = np.unique(np.round(hull.equations, 12), axis=0)
    parts = np.array_split(queries, 1 + queries.shape[0] * len(planes) // 5_000_000)
    return np.concatenate([-(part @ planes[:, :3].T + planes[:, 3]).max(axis=1) for part in parts])


def _refuse_open_or_hollow(cloud: Floats, faces: Ints, hull: "ConvexHull", name: str) -> None:
    wrong = int((triangle_edge_counts(faces) != 2).sum())
    if wrong:
        raise MeshError(f'the surface "{name}" is not closed: {counted(wrong, "edge")} without exactly two triangles')
    a, b, c = (cloud[faces[:, i]] - cloud.mean(axis=0) for i in range(3))
    inside = abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6.0
    if abs(hull.volume - inside) > CONVEX * hull.volume:
        raise MeshError(
            f'the surface "{name}" is not convex (or its triangles are turned both ways): it encloses '
            f"{inside:.4g} m^3, its convex hull {hull.volume:.4g} m^3: "
            "mesh its volume with a mesher such as Gmsh or TetGen"
        )


def _lattice_inside(cloud: Floats, hull: "ConvexHull", spacing: float, name: str) -> Floats:
    """Points of a body-centred cubic lattice that lie deeper than half the spacing under the hull."""
    period = spacing * 2.0 / 3**0.5  # a node's eight nearest neighbours are at period * sqrt(3) / 2
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    counts = np.ceil((high - low) / period).astype(np.int64) + 1
    if 2.0 * np.prod(counts.astype(np.float64)) > MOST_POINTS:
        raise MeshError(
            f'spacing={spacing:.3g} m would put over {MOST_POINTS} nodes into "{name}": give a larger spacing'
        )
    axes = [0.5 * (a + b) + period * (np.arange(n) - 0.5 * (n - 1)) for a, b, n in zip(low, high, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = np.concatenate([grid, grid + 0.5 * period])
    return grid[_depth(grid, hull) > 0.5 * spacing]
