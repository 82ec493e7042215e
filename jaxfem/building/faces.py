"""Faces of soft bodies against shapes that nodes alone would miss: triangles, and the shape's own points on them."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxfem.building.meetings import Meeting, repeated
from jaxfem.rigid.shapes import Shape
from jaxfem.rows.attachments import RigidPoint, WorldPoint
from jaxfem.rows.contact import SurfaceContacts
from jaxfem.rows.faces import MOST_FACES, FaceContacts

AROUND_RIM = 8
"""Points of a rim that touch a soft body's surface."""


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
        shape.measured() if shape.shared else repeated(shape.measured(), count),
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
    """Points (k, 3) of a shape that may sink into a face: some of each rim, and the sharp ones of ground; those of
    bodies do so everywhere."""
    turn = np.arange(AROUND_RIM) * (2 * np.pi / AROUND_RIM)
    rims = shape.circles()
    around = rims[:, :1] + np.cos(turn)[:, None] * rims[:, 1:2] + np.sin(turn)[:, None] * rims[:, 2:]
    found = [around.reshape(-1, 3)]
    if ground and shape.has_points():
        places, radius = shape.features()
        found.append(places[radius == 0])
    return np.concatenate(found)
