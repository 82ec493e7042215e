"""What a usable mesh may still spoil in a simulation, in words: seams, parts, elements that are nearly flat."""

import numpy as np

from .checks import Floats, counted, edge_lengths
from .seams import close_pairs, reach_of
from .tet import TetMesh
from .topology import components, dihedral_angles

POOR_ANGLE = 5.0  # degrees
# An element of volume V, longest edge L and least angle a has V <= L^3 sin(a) / 6: of the others no angle is taken.
THIN = float(np.sin(np.radians(POOR_ANGLE))) / 6


def troubles(mesh: TetMesh) -> tuple[str, ...]:
    """A sentence for each trouble, with its remedy; empty for a good mesh. Cheap enough for every `build`."""
    lengths = edge_lengths(mesh.points, mesh.cells)
    thin = np.flatnonzero(mesh.volumes <= THIN * 1.001 * lengths.max(axis=1) ** 3)
    angles = dihedral_angles(mesh.points, mesh.cells[thin]).min(axis=1)
    return (
        *_flat(thin[angles < POOR_ANGLE], angles[angles < POOR_ANGLE]),
        *_seams(components(mesh.cells, len(mesh.points)), coincident(mesh.points, float(lengths.min()))),
    )


def _flat(numbers: np.ndarray, angles: Floats) -> tuple[str, ...]:
    """Says which element is the flattest, and how many are nearly flat."""
    if not len(numbers):
        return ()
    worst = int(np.argmin(angles))
    more = "" if len(numbers) == 1 else f", {len(numbers)} elements in all"
    return (f"element {numbers[worst]} is nearly flat (smallest angle {angles[worst]:.2g} degrees{more}): remesh",)


def _seams(parts: int, doubled: int) -> tuple[str, ...]:
    """Says that a mesh falls into parts, and that nodes lie on top of others."""
    found = [f"the mesh falls into {parts} parts that share no node"] if parts > 1 else []
    if doubled:
        lie = "1 node lies" if doubled == 1 else f"{counted(doubled, 'node')} lie"
        found.append(
            f"{lie} on top of another: merge them if the parts are meant to join (read(path, merge=True) or "
            "mesh.merged(), in scene files merge = true)"
        )
    return tuple(found)


def coincident(points: Floats, shortest: float) -> int:
    """How many nodes have another within rounding."""
    return len(np.unique(close_pairs(points, reach_of(points, shortest))))
