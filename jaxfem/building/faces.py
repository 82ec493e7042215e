"""What nodes of soft bodies alone would miss: their triangles against shapes, with the shape's own points on them; and
points of edges between nodes, against soft bodies."""

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxfem.building.meetings import Meeting, bounds_at_corners, measured_by, triangles_around
from jaxfem.declared.errors import AccuracyWarning
from jaxfem.rigid.shapes import Shape
from jaxfem.rows.attachments import RigidPoint, SoftPoint, WorldPoint
from jaxfem.rows.between_nodes import BetweenNodes, PatchEdges
from jaxfem.rows.faces import MOST_FACES, FaceContacts
from jaxfem.rows.surfaces import SurfaceContacts

AROUND_RIM = 8
"""Points of a rim that touch a soft body's surface."""
APART, MOST_PARTS = 0.5, 6
"""Of the other body's thickness: how far apart points of an edge are; and parts that an edge has at most."""

FEW = 2
"""Points that are chosen for themselves, not as parts of a surface."""


def faces_on_shape(meeting: Meeting) -> Iterator[Any]:
    """Triangles of a soft a against a rigid b or ground, and the latter's points against the triangles.

    Where the contact says so, or where it does not and the shape may slip between the nodes.
    """
    shape, number = meeting.opposite
    if meeting.a.kind != "soft" or shape is None or shape.flat or not shape.is_obstacle():
        return
    triangles = meeting.faces()
    if not len(triangles) or not _wanted(meeting, shape, triangles):
        return
    count = len(triangles)
    most = MOST_FACES if count > MOST_FACES else 0
    middle = np.zeros(3) if number is None else meeting.bodies.rigid[number].properties[1]
    yield FaceContacts(
        triangles,
        measured_by(meeting, shape, count),
        None if number is None else np.full(count, number, np.int32),
        np.full(most or count, meeting.margin),
        meeting.rough,
        shape.shared,
        most,
        offset=None if number is None else np.tile(middle, (count, 1)),
    )
    places = _other_points(shape, number is None)
    if not len(places):
        return
    points = (
        WorldPoint(places) if number is None else RigidPoint(np.full(len(places), number, np.int32), places - middle)
    )
    each = np.broadcast_to(triangles, (len(places), *triangles.shape))
    yield SurfaceContacts(points, each, np.full(len(places), meeting.margin), meeting.rough)


def _wanted(meeting: Meeting, shape: Shape, triangles: np.ndarray) -> bool:
    if meeting.contact.faces is not None:
        return bool(meeting.contact.faces)
    rest = np.concatenate([body.mesh.points for body in meeting.bodies.soft])[triangles]
    widest = np.linalg.norm(rest - np.roll(rest, 1, axis=1), axis=-1).max()
    return bool(shape.thickness() < widest)


def _other_points(shape: Shape, ground: bool) -> np.ndarray:
    """Points (k, 3) of a shape that may sink into a face: some of each rim, and the sharp ones of ground that is no
    convex solid; those of others do so everywhere."""
    turn = np.arange(AROUND_RIM) * (2 * np.pi / AROUND_RIM)
    rims = shape.circles()
    around = rims[:, :1] + np.cos(turn)[:, None] * rims[:, 1:2] + np.sin(turn)[:, None] * rims[:, 2:]
    found = [around.reshape(-1, 3)]
    if ground and shape.has_points() and not bounds_at_corners(shape, ground):
        places, radius = shape.features()
        found.append(places[radius == 0])
    return np.concatenate(found)


def warn_between_points(meeting: Meeting) -> None:
    """Warn where the other side may slip between the points of a soft a that the user chose, and nothing else meets it.

    Triangles of chosen nodes meet what is thin, vertices of an embedded surface have none; a soft b's nodes meet a's
    triangles only where a's points are not chosen. Some points at most are taken at their word.
    """
    a, b = meeting.a, meeting.b
    if a.kind != "soft" or a == b or not meeting.chosen or meeting.contact.faces is False:
        return
    if b is not None and b.kind == "soft":
        thickness = _thickness(meeting.bodies.soft[b.number].mesh.points)
    else:
        shape = meeting.opposite[0]
        thickness = np.inf if shape is None or len(meeting.faces()) else shape.thickness()
    if not np.isfinite(thickness) or (apart := _apart(meeting)) <= thickness:
        return
    what = "vertices of its surface" if meeting.contact.surface is not None else "its nodes"
    warnings.warn(
        f"{meeting.where}: {what} are up to {apart:.3g} m apart and the other side is {thickness:.3g} m thin, so it "
        "may pass between them: give a finer surface or more nodes, or leave them out, so that triangles touch as well "
        "(faces=False where that does not matter)",
        AccuracyWarning,
        stacklevel=5,
    )


def _apart(meeting: Meeting) -> float:
    """How far [m] a's point that is furthest from the one next to it is, at rest; 0 for few."""
    from scipy.spatial import cKDTree  # slow to import: only where points are chosen

    points = meeting.points.points
    rest = np.concatenate([body.mesh.points for body in meeting.bodies.soft])
    places = np.einsum("qk,qki->qi", points.weights, rest[points.nodes])
    return float(cKDTree(places).query(places, k=2)[0][:, 1].max()) if len(places) > FEW else 0.0


def edges_on_surfaces(meeting: Meeting) -> Iterator[BetweenNodes]:
    """Points between the nodes of two soft bodies' edges, each against the other's surface.

    Where the contact says so; where it says nothing and one may slip between the nodes of the other, a warning says
    that: with friction these points may take a step thirty times the iterations.
    """
    a, b, wanted = meeting.a, meeting.b, meeting.contact.faces
    if b is None or {a.kind, b.kind} != {"soft"}:
        return
    if a == b:
        yield from _between_patches(meeting)
        return
    if meeting.chosen or wanted is False:
        return
    for one, other in ((a, b), (b, a)):
        thickness = _thickness(meeting.bodies.soft[other.number].mesh.points)
        triangles = meeting.surface(one)
        if wanted:
            found = _between_nodes(meeting, triangles, thickness)
            around = triangles_around(found, triangles)
            yield BetweenNodes(**_against(meeting, found, meeting.surface(other)), around=around)
        elif (widest := _edges(meeting, triangles)[1].max()) > thickness:
            _warn_of_edges(meeting, "body", widest, f"{thickness:.3g} m thin")
            return


def _between_patches(meeting: Meeting) -> Iterator[PatchEdges]:
    """The same of two patches of one body."""
    wanted, patches = meeting.contact.faces, meeting.patches()
    places = np.concatenate([body.mesh.points for body in meeting.bodies.soft])
    for (_, triangles), (_, own) in zip(patches, patches[::-1], strict=True):
        if wanted:
            found = _between_nodes(meeting, own, np.inf)
            yield PatchEdges(**_against(meeting, found, triangles), deep=np.full(len(found.nodes), 2 * meeting.margin))
            continue
        width, widest = _width(places[np.unique(triangles)]), _edges(meeting, own)[1].max()
        if wanted is None and widest > width:
            _warn_of_edges(meeting, "patch", widest, f"{width:.3g} m wide", above=8)
            return


def _warn_of_edges(meeting: Meeting, what: str, widest: float, other: str, above: int = 7) -> None:
    warnings.warn(
        f"{meeting.where}: nodes of one {what} are up to {widest:.3g} m apart and the other is {other}, so edges may "
        "pass through each other between nodes: refine the mesh, or say faces=True, which takes longer (faces=False "
        "where that does not matter)",
        AccuracyWarning,
        stacklevel=above,
    )


def _against(meeting: Meeting, points: SoftPoint, triangles: np.ndarray) -> dict[str, Any]:
    """Fields of candidates of points (k) against triangles (t, 3)."""
    count = len(points.nodes)
    each = np.broadcast_to(triangles, (count, *triangles.shape))
    return {"points": points, "triangles": each, "margin": np.full(count, meeting.margin), "rough": meeting.rough}


def _between_nodes(meeting: Meeting, triangles: np.ndarray, thickness: float) -> SoftPoint:
    """Points of the triangles' edges, as far apart as is near enough for what is so thick."""
    edges, length = _edges(meeting, triangles)
    parts = np.clip(np.ceil(length / (APART * thickness)), 2, MOST_PARTS).astype(int)
    owner = np.repeat(np.arange(len(edges)), parts - 1)
    number = np.concatenate([np.zeros(0, int), *(np.arange(1, count) for count in parts)])
    share = number / parts[owner]
    return SoftPoint(edges[owner].astype(np.int32), np.stack([1 - share, share], 1))


def _edges(meeting: Meeting, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (e, 2) of triangles, and their lengths (e,) [m]."""
    places = np.concatenate([body.mesh.points for body in meeting.bodies.soft])
    edges = np.unique(np.sort(np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1), axis=0)
    return edges, np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)


def _thickness(points: np.ndarray) -> float:
    """The least extent [m] of a body, along the axes or along its own."""
    return float(min(np.ptp(points, axis=0).min(), _extents(points).min()))


def _width(points: np.ndarray) -> float:
    """The middle one of a patch's extents [m]: how wide a strip is."""
    return float(np.sort(_extents(points))[1])


def _extents(points: np.ndarray) -> np.ndarray:
    """Of points along their own axes, (3,) [m]."""
    own = np.linalg.svd(points - points.mean(0), full_matrices=False)[2]
    return np.asarray(np.ptp(points @ own.T, axis=0))
