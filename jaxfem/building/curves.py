"""Curves of rigid bodies (rims, edges, axes along which a ball is swept) as candidates against a partner's shape."""

from collections.abc import Iterator

import numpy as np

from jaxfem.building.meetings import Meeting, measured_by
from jaxfem.rigid.shapes import Shape
from jaxfem.rows.curves import MOST_CURVES, TOUCHES, CurveContacts


def curves_on_shapes(meeting: Meeting) -> Iterator[CurveContacts]:
    """Curves of each side against the other's shape."""
    a, b, ground = meeting.a, meeting.b, meeting.ground
    if a.shape is None:
        return
    partner = ground if b is None else b.shape
    if partner is None:
        return
    edged = b is not None and a.shape.edges() is not None and partner.edges() is not None
    sides = (a.shape, a.number), (partner, None if b is None else b.number)
    for one, other in (sides, sides[::-1]):
        if other[0].is_obstacle():
            segments = not edged and _needed(one[0], other[0], first=one is sides[0])
            yield from _against(meeting, one, other, segments)


def _needed(one: Shape, other: Shape, first: bool) -> bool:
    """Whether segments of one side tell what those of the other against it do not; of two alike, the first one's do.

    A swept shape's own are enough against what is convex; what is not convex has edges of its own, if it has points.
    """
    ball = other.swept and not len(other.segments()[1]) and one.is_obstacle()  # its centre tells all
    if other.flat or ball:
        return False
    if not other.convex:
        return not other.has_points() or (first and not one.convex)
    return not (one.convex and other.swept) or (first and one.swept)


def _against(
    meeting: Meeting, one: tuple[Shape, int | None], other: tuple[Shape, int | None], segments: bool
) -> Iterator[CurveContacts]:
    """Rims of a rigid body or of ground (None), and its segments if asked for, against the shape of another."""
    (own, number), (shape, body) = one, other
    middle = np.zeros(3) if number is None else meeting.bodies.rigid[number].properties[1]
    ends, swept = own.segments() if segments else (np.zeros((0, 2, 3)), np.zeros(0))
    rims = own.circles()
    halves = (ends.mean(1) - middle, (ends[:, 1] - ends[:, 0]) / 2, None, swept)
    rounds = (rims[:, 0] - middle, rims[:, 1], rims[:, 2], np.zeros(len(rims)))
    for centre, first, second, radius in (halves, rounds):
        if not (count := len(radius)):
            continue
        most = MOST_CURVES if count > MOST_CURVES else 0
        yield CurveContacts(
            None if number is None else np.full(count, number, np.int32),
            centre,
            first,
            second,
            radius,
            measured_by(meeting, shape, count, float(radius.max())),
            None if body is None else np.full(count, body, np.int32),
            np.full((most or count) * TOUCHES[second is not None], meeting.margin),
            meeting.rough,
            shape.shared,
            most,
            offset=None if body is None else np.tile(meeting.bodies.rigid[body].properties[1], (count, 1)),
        )
