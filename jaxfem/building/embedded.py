"""Points that move with the elements of a soft body: vertices of a surface embedded in its mesh."""

import warnings
from typing import Any

import numpy as np

from jaxfem.declared import SceneError
from jaxfem.mesh import MeshError, MeshWarning, TetMesh, locate

FARTHEST = 0.25
"""How far out a point may lie, as a share of the body's size."""
TOLD = 0.02
"""The same, from which a point is warned of: it moves as if the element nearest to it went on out there."""
LARGEST = 5.0
"""Largest weight of a corner: those of a flat element grow without bounds outside it, and any noise with them."""


def embedded(mesh: TetMesh, points: Any, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners (q, 4) and their weights (q, 4), sum 1, for `points` (q, 3) [m] at rest; `what`: words for messages.

    A point outside the mesh goes with the element under the nearest point of its surface, by weights that may be
    negative: it stays where it is at rest. SceneError for points that are far out.
    """
    try:
        cell, _, outside = locate(mesh.points, mesh.cells, points)
    except MeshError as error:
        raise SceneError(f"{what}: {error}") from None
    if not len(cell):
        raise SceneError(f"{what} has no point: give its vertices (q, 3) in m")
    size = float(np.ptp(mesh.points, axis=0).max())
    corners = mesh.points[mesh.cells[cell]]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    rest = np.linalg.solve(edges, (np.asarray(points, float) - corners[:, 0])[..., None])[..., 0]
    weights = np.column_stack([1 - rest.sum(1), rest])
    far = np.flatnonzero((outside > FARTHEST * size) | (np.abs(weights).max(1) > LARGEST))
    if len(far):
        raise SceneError(
            f"{what}: point {far[0]} at {tuple(np.asarray(points, float)[far[0]].round(6).tolist())} is "
            f"{outside[far[0]]:.3g} m outside the mesh, too far to move with an element of it: check units and place, "
            "or mesh the body closer to its surface"
        )
    out = outside > TOLD * size
    if out.any():
        warnings.warn(
            f"{what}: {out.sum()} of {len(out)} points lie outside the mesh, up to {outside.max():.3g} m: they move "
            "with the nearest element; a cage around them (jf.mesh.cage) has none outside",
            MeshWarning,
            stacklevel=4,
        )
    return mesh.cells[cell], weights
