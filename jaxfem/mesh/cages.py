"""A coarse mesh around a surface: the tetrahedra of a grid, whole cells, of which those inside or cut are kept.

What is inside is what a flood from outside does not reach through cells that no triangle touches, so cracks smaller
than a cell are no harm. Cells and triangles: separating axes (Akenine-Moeller 2001).
"""

import warnings
from typing import Any

import numpy as np

from .checks import Floats, Ints, MeshError, MeshWarning, as_points, as_triangles, is_positive
from .generators import CUTS, box
from .tet import TetMesh
from .topology import first_of_each

ELEMENTS = 1500
PAIRS = 2_000_000  # of triangles and cells, looked at together
SEARCHES = 16
"""Sizes tried for a wanted number of elements."""
CLOSE = 0.02


def cage(
    points: Any,
    triangles: Any,
    elements: int | None = None,
    size: float | None = None,
    name: str = "cage",
    tets_per_cell: int = 6,
) -> TetMesh:
    """Tetrahedra of grid cells of `size` [m] around a closed surface, `points` (n, 3) [m] and `triangles` (k, 3).

    Or of about as many `elements` (1500 where neither is given; grids step, so a tenth more or less). No point of the
    surface is outside. `notes` say what the cage holds beside the surface's volume: its mass is that of all the cage.
    MeshError for what is no surface, and for both size and elements; a MeshWarning where
    holes leave it hollow.
    """
    places = as_points(points, name)
    faces = as_triangles(triangles, len(places), name)
    if size is not None and elements is not None:
        raise MeshError(f'the cage "{name}" is given both size and elements: give one of them')
    for what, value in (("size", size), ("elements", elements)):
        if value is not None and not is_positive(value):
            raise MeshError(f'{what} of the cage "{name}" is {value!r}: give a positive number')
    if tets_per_cell not in CUTS:
        raise MeshError(f"tets_per_cell={tets_per_cell!r}: a cell can be cut into 5, 6 or 12 tetrahedra")
    corners = places[faces]
    if np.ptp(corners.reshape(-1, 3), axis=0).min() == 0:
        raise MeshError(f'the surface "{name}" is flat: it has no inside for a cage')
    width = float(size) if size is not None else _width(corners, (elements or ELEMENTS) / tets_per_cell)
    origin, kept = _cells(corners, width)
    whole = box((width * np.array(kept.shape)).tolist(), kept.shape, tets_per_cell, origin.tolist(), name)
    chosen = whole.cells[np.repeat(kept.ravel(), tets_per_cell)]
    used, numbers = np.unique(chosen, return_inverse=True)
    mesh = TetMesh(whole.points[used], numbers.reshape(-1, 4), name)
    note = f"a cage of {len(chosen)} elements, {width:.3g} m a cell, around {len(faces)} triangles: it holds "
    return TetMesh(mesh.points, mesh.cells, name, notes=(*mesh.notes, note + _held(corners, width, mesh.volume, name)))


def _held(corners: Floats, width: float, volume: float, name: str) -> str:
    """What a cage of `volume` [m^3] holds of the inside of triangles (t, 3, 3), in words; warns where it is hollow."""
    caps, alike = _caps(corners)
    closed = np.concatenate([corners, caps])
    if len(caps):
        origin, kept = _cells(corners, width)
        filled = _cells(closed, width)[1]
        filled.ravel()[_cut_cells((caps - origin) / width, np.array(kept.shape))] = False
        if (filled & ~kept).any():
            warnings.warn(
                f'the surface "{name}" has holes wider than the cells of its cage ({width:.3g} m), through which the '
                "outside reaches in: the cage is hollow. Close the surface, or take larger cells",
                MeshWarning,
                stacklevel=4,
            )
            return "a surface with holes, hollow"
    if not alike:
        return "triangles that are not turned alike, whose volume is not known"
    inside = abs(float(np.einsum("ti,ti->", closed[:, 0], np.cross(closed[:, 1], closed[:, 2])) / 6))
    if inside < 1e-12 * volume:
        return "triangles that enclose nothing"
    return f"{volume / inside:.3g} times their volume, so {inside / volume:.3g} of its density gives its mass"


def _caps(corners: Floats) -> tuple[Floats, bool]:
    """Triangles (c, 3, 3) from holes' rims to their middles, and whether neighbours (t, 3, 3) are turned alike."""
    flat = corners.reshape(-1, 3)
    digit = 1e-9 * np.ptp(flat, axis=0).max()
    _, first, nodes = np.unique(np.round(flat / digit), axis=0, return_index=True, return_inverse=True)
    edges = nodes.reshape(-1, 3)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, number, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    number = number.ravel()
    way = np.bincount(number, np.where(edges[:, 0] < edges[:, 1], 1, -1))
    rim = edges[count[number] == 1]
    hole = first_of_each(len(first), rim)[rim[:, 0]] if len(rim) else rim[:, 0]
    caps = np.empty((len(rim), 3, 3))
    for each in np.unique(hole):
        ends = flat[first[rim[hole == each]]]
        caps[hole == each] = np.stack([ends[:, 1], ends[:, 0], np.broadcast_to(ends.mean((0, 1)), (len(ends), 3))], 1)
    return caps, not way[count == 2].any()


def _width(corners: Floats, wanted: float) -> float:
    """The cell's width [m] with about `wanted` cells in the cage."""
    extent = np.ptp(corners.reshape(-1, 3), axis=0)
    low, high = float(extent.max()) / (4 * wanted), float(extent.max())
    low = max(low, float((extent.prod() / (40 * wanted)) ** (1 / 3)))
    best, least = high, np.inf
    for _ in range(SEARCHES):
        middle = float(np.sqrt(low * high))
        count = int(_cells(corners, middle)[1].sum())
        if abs(count - wanted) < least:
            best, least = middle, abs(count - wanted)
        if abs(count - wanted) <= CLOSE * wanted:
            break
        low, high = (middle, high) if count > wanted else (low, middle)
    return best


def _cells(corners: Floats, width: float) -> tuple[Floats, Any]:
    """Origin (3,) of a grid of cells `width` wide around triangles (k, 3, 3), and which cells are kept (nx, ny, nz)."""
    low, high = corners.min((0, 1)), corners.max((0, 1))
    counts = np.maximum(np.ceil((high - low) / width - 1e-9), 1).astype(int)
    origin = (low + high - counts * width) / 2
    cut = np.zeros(counts, bool)
    cut.ravel()[_cut_cells((corners - origin) / width, counts)] = True
    return origin, ~_outside(cut)


def _cut_cells(corners: Floats, counts: Ints) -> Ints:
    """Numbers of the unit cells (i, j, k) that triangles (t, 3, 3) touch."""
    first = np.clip(np.floor(corners.min(1) - 1e-9).astype(int), 0, counts - 1)
    last = np.clip(np.floor(corners.max(1) + 1e-9).astype(int), 0, counts - 1)
    spans = last - first + 1
    many, found = spans.prod(1), []
    for batch in np.split(np.arange(len(corners)), np.flatnonzero(np.diff(np.cumsum(many) // PAIRS)) + 1):
        triangle = np.repeat(batch, many[batch])
        rank = np.arange(len(triangle)) - np.repeat(np.cumsum(many[batch]) - many[batch], many[batch])
        span = spans[triangle]
        steps = np.column_stack([rank // (span[:, 1] * span[:, 2]), rank // span[:, 2] % span[:, 1], rank % span[:, 2]])
        cell = first[triangle] + steps
        hit = _overlaps(corners[triangle] - (cell + 0.5)[:, None])
        found.append(np.unique(np.ravel_multi_index(tuple(cell[hit].T), tuple(counts))))
    return np.unique(np.concatenate(found))


def _overlaps(corners: Floats) -> Any:
    """Whether triangles (p, 3, 3) touch the unit cell around the origin: no axis separates them."""
    edges = np.roll(corners, -1, axis=1) - corners
    axes = [np.cross(edges[:, :, None], np.eye(3)).reshape(len(corners), 9, 3)]
    axes += [np.cross(edges[:, 0], edges[:, 1])[:, None], np.broadcast_to(np.eye(3), (len(corners), 3, 3))]
    every = np.concatenate(axes, axis=1)
    along = np.einsum("pai,pci->pac", every, corners)
    reach = 0.5 * np.abs(every).sum(-1) * (1 + 1e-9)
    return ((along.min(-1) <= reach) & (along.max(-1) >= -reach)).all(1)


def _outside(cut: Any) -> Any:
    """Cells that a flood reaches from around the grid through cells that are not `cut`."""
    empty = np.pad(~cut, 1, constant_values=True)
    reached = np.zeros_like(empty)
    reached[0, 0, 0] = True
    while True:
        grown = reached.copy()
        for axis in range(3):
            ahead, behind = _part(axis, 1, None), _part(axis, 0, -1)
            grown[ahead] |= reached[behind]
            grown[behind] |= reached[ahead]
        grown &= empty
        if (grown == reached).all():
            return reached[1:-1, 1:-1, 1:-1]
        reached = grown


def _part(axis: int, start: int, stop: int | None) -> tuple[slice, ...]:
    return tuple(slice(start, stop) if each == axis else slice(None) for each in range(3))
