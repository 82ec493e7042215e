"""Soft bodies inside others, or with others inside, where no point that touches tells: found by places inside them.

Contact looks from points of surfaces. Where two surfaces coincide all gaps are 0, and a small thing between the nodes
of a body sees none of its faces from within: such bodies would stay in each other without a word.
"""

from typing import Any

import jax
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.declared import Contact
from jaxfem.rigid.shapes import Shape
from jaxfem.rigid.shapes.nearest import feature_normals, square_distances

MOST = 256
"""Places inside of a body that are looked at."""
ALONG = 5  # of a rigid body's bounding box, along each side
PAIRS = 100_000  # of places and triangles that are looked at together


def enclosed_depth(contact: Contact, index: BodyIndex) -> float:
    """How deep [m] places inside of one partner are in the other at the start, of a pair with a soft body; else 0.

    Host side. A contact of chosen nodes or of an embedded surface is taken at its word.
    """
    if isinstance(contact.b, Shape) or contact.nodes is not None or contact.surface is not None:
        return 0.0
    a, b = (index.find(body, "a contact") for body in (contact.a, contact.b))
    if a == b or "soft" not in (a[0], b[0]):
        return 0.0
    return max(_depth(index, one, other) for one, other in ((a, b), (b, a)))


def _depth(index: BodyIndex, one: tuple[str, int], other: tuple[str, int]) -> float:
    low, high = _box(index, other)
    places = _inside(index, one)
    places = places[((places > low) & (places < high)).all(1)]
    if not len(places):
        return 0.0
    kind, number = other
    if kind == "soft":
        mesh = index.soft[number].mesh
        gaps = _signed_distances(places, mesh.points, mesh.surface)
    else:
        gaps = _distances(index.rigid[number].shape, _to_shape(index, number, places))
    return float(max(0.0, -gaps.min()))


def _box(index: BodyIndex, side: tuple[str, int]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of the box around a body."""
    kind, number = side
    if kind == "soft":
        points = index.soft[number].mesh.points
    else:
        extent = index.rigid[number].shape.extent()
        if not len(extent):
            return np.full(3, np.inf), np.full(3, -np.inf)
        corners = np.stack(np.meshgrid(*np.stack([extent.min(0), extent.max(0)]).T, indexing="ij"), -1).reshape(-1, 3)
        points = _to_world(index, number, corners)
    return points.min(0), points.max(0)


def _inside(index: BodyIndex, side: tuple[str, int]) -> np.ndarray:
    """Places (k, 3) inside of a body: middles of elements, or a grid within a shape."""
    kind, number = side
    if kind == "soft":
        mesh = index.soft[number].mesh
        cells = mesh.cells[:: -(-len(mesh.cells) // MOST)]
        middles: np.ndarray = mesh.points[cells].mean(1)
        return middles
    shape = index.rigid[number].shape
    extent = shape.extent()
    if not len(extent):
        return np.zeros((0, 3))
    share = (np.arange(ALONG) + 0.5) / ALONG
    low, size = extent.min(0), np.ptp(extent, axis=0)
    grid = low + size * np.stack(np.meshgrid(share, share, share, indexing="ij"), -1).reshape(-1, 3)
    return _to_world(index, number, grid[_distances(shape, grid) < 0])


def _to_world(index: BodyIndex, number: int, places: np.ndarray) -> np.ndarray:
    middle = index.rigid[number].properties[1]
    found: np.ndarray = (places - middle) @ index.rotations[number].T + index.centers[number]
    return found


def _to_shape(index: BodyIndex, number: int, places: np.ndarray) -> np.ndarray:
    middle = index.rigid[number].properties[1]
    found: np.ndarray = (places - index.centers[number]) @ index.rotations[number] + middle
    return found


def _distances(shape: Any, places: np.ndarray) -> np.ndarray:
    """Signed distances (k,) [m] of places in a shape's frame; infinite for what others cannot touch."""
    if not shape.is_obstacle():
        return np.full(len(places), np.inf)
    measured = shape.measured()
    return np.asarray(jax.vmap(measured.distance)(places), float)


def _signed_distances(places: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Signed distances (k,) [m] from a closed surface, negative inside."""
    corners, normals = points[triangles], feature_normals(points, triangles)
    step = max(1, PAIRS // len(triangles))
    found = [np.zeros(0)]
    for part in (places[k : k + step] for k in range(0, len(places), step)):
        squares, weights, feature = square_distances(np, part[:, None], corners[None])
        nearest, rows = squares.argmin(1), np.arange(len(part))
        foot = (weights[rows, nearest][..., None] * corners[nearest]).sum(1)
        way = part - foot
        side = (way * normals[nearest, feature[rows, nearest]]).sum(1)
        found.append(np.copysign(np.linalg.norm(way, axis=1), side))
    return np.concatenate(found)
