"""Declared contacts as groups of candidates: all pairs of one kind in one set of arrays."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.building.curves import curves_on_shapes
from jaxfem.building.faces import edges_on_surfaces, faces_on_shape, warn_between_points
from jaxfem.building.meetings import (
    Meeting,
    Touching,
    bounds_at_corners,
    measured_by,
    meeting_of,
    triangles_around,
)
from jaxfem.building.row_groups import device_type
from jaxfem.declared import Contact, SceneError
from jaxfem.pytrees import on_device
from jaxfem.rigid.shapes import Shape
from jaxfem.rows.attachments import RigidPoint, SoftPoint, WorldPoint
from jaxfem.rows.box_edges import MOST, BoxEdges
from jaxfem.rows.candidates import Candidates
from jaxfem.rows.contact import ContactValues, ShapeContacts
from jaxfem.rows.corners import CornerContacts
from jaxfem.rows.nearby import MOST_POINTS, NearbyContacts
from jaxfem.rows.patches import PatchContacts
from jaxfem.rows.surfaces import SurfaceContacts
from jaxfem.rows.thinned import thinned


def contact_parts(contacts: Sequence[Contact], index: BodyIndex, dtype: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Groups of candidates and their values, both by name: "rough soft-ground plane", with the contact's own name
    behind where it cannot share a group.

    In each group `names` says which contact each entry is of: its own name, or its place in the scene's list.
    """
    grouped: dict[str, list[tuple[Any, ContactValues]]] = {}
    for number, contact in enumerate(contacts):
        if not isinstance(contact, Contact):
            raise SceneError(f"contacts holds a {type(contact).__name__}: write contacts=[Contact(a, b), ...]")
        name = contact.name or str(number)
        where = f'contact "{name}"' if contact.name else f"contact {name}"
        meeting = meeting_of(contact, index, where, dtype)
        made = [each for make in MAKERS for each in make(meeting)]
        if not made:
            raise SceneError(
                f"{where}: its partners have nothing that could meet, points or curves of one against the distance of "
                "the other; give a shape `features` or `segments`, or a TriangleMesh in its place"
            )
        warn_between_points(meeting)
        for candidates in made:
            count = len(candidates.margin)
            numbers = contact.friction, contact.restitution, meeting.separation
            values = ContactValues(*(np.full(count, each) for each in numbers))
            cone = candidates.rough and contact.cone
            label = f"{'cone' if cone else 'rough' if candidates.rough else 'smooth'} {candidates.kind}"
            if candidates.alone or (label in grouped and _kind(candidates) != _kind(grouped[label][0][0])):
                label = f"{label} {name}"
                label = f"{label} back" if label in grouped else label
            grouped.setdefault(label, []).append((candidates.replace(names=(name,) * count, cone=cone), values))
    rows = {label: _joined([each for each, _ in parts], dtype) for label, parts in grouped.items()}
    return rows, {label: _joined([each for _, each in parts], dtype) for label, parts in grouped.items()}


def points_on_ground(meeting: Meeting) -> Iterator[Candidates]:
    """Points of a against ground."""
    if meeting.ground is not None and len(meeting.points.radius):
        yield _against(meeting, meeting.points, meeting.ground, None)


def ground_on_shape(meeting: Meeting) -> Iterator[Candidates]:
    """Peaks and corners of ground against the shape of a rigid a, unless that is a ball."""
    ground, shape = meeting.ground, meeting.a.shape
    if ground is None or shape is None or not (ground.has_points() and shape.is_obstacle()) or meeting.a.is_ball:
        return
    places, radius = ground.features()
    if len(radius):
        yield _against(meeting, Touching(WorldPoint(places), radius), shape, meeting.a.number)


def nodes_on_surfaces(meeting: Meeting) -> Iterator[Candidates]:
    """Points of a against the surface of a soft b; all of b's against a's too, where a's are not chosen."""
    a, b = meeting.a, meeting.b
    if b is None or b.kind != "soft" or a == b:
        return
    ways = [(meeting.points, a, b)]
    if not meeting.chosen:
        ways.append((meeting.points_of(b), b, a))
    for points, own, other in ways:
        triangles = meeting.surface(other)
        each = np.broadcast_to(triangles, (len(points.radius), *triangles.shape))
        around = triangles_around(points.points, meeting.surface(own))
        found = SurfaceContacts(points.points, each, meeting.margins(points), meeting.rough, around=around)
        yield thinned(found, meeting.contact.per_node) if meeting.is_embedded(points) else found


def patches_on_each_other(meeting: Meeting) -> Iterator[PatchContacts]:
    """Two patches of a soft body that touches itself."""
    if meeting.a != meeting.b:
        return
    for points, triangles in meeting.patches():
        each, margin = np.broadcast_to(triangles, (len(points.radius), *triangles.shape)), meeting.margins(points)
        yield PatchContacts(points.points, each, margin, meeting.rough, deep=2 * margin)


def points_on_shape(meeting: Meeting) -> Iterator[Candidates]:
    """Points of a against the shape of a rigid b."""
    b = meeting.b
    if b is not None and b.shape is not None and b.shape.is_obstacle() and len(meeting.points.radius):
        yield _against(meeting, meeting.points, b.shape, b.number)


def corners_on_surface(meeting: Meeting) -> Iterator[CornerContacts]:
    """Sharp points of a rigid b, or of ground that is a convex solid, against the surface of a soft a, where a's points
    are not chosen."""
    shape, number = meeting.opposite
    if meeting.a.kind != "soft" or shape is None or meeting.chosen or not bounds_at_corners(shape, number is None):
        return
    places, radius = shape.features()
    places = places[radius == 0]
    if not len(places):
        return
    middle = shape.mass_properties()[1] if number is None else meeting.bodies.rigid[number].properties[1]
    local = places - middle
    lengths = np.linalg.norm(local, axis=1, keepdims=True)
    points = WorldPoint(places) if number is None else RigidPoint(np.full(len(local), number, np.int32), local)
    triangles = np.broadcast_to(meeting.surface(meeting.a), (len(local), *meeting.surface(meeting.a).shape))
    outward = local / np.where(lengths > 0, lengths, 1)
    yield CornerContacts(points, outward, triangles, np.full(len(local), meeting.margin), meeting.rough)


def edges_on_edges(meeting: Meeting) -> Iterator[BoxEdges]:
    """Edges of blocks against each other, which points do not see."""
    a, b = meeting.a, meeting.b
    if b is None or a.shape is None or b.shape is None:
        return
    half_a, half_b = a.shape.edges(), b.shape.edges()
    if half_a is None or half_b is None:
        return
    one, other = np.full(1, a.number, np.int32), np.full(1, b.number, np.int32)
    origin_a, origin_b = (-meeting.bodies.rigid[side.number].properties[1][None] for side in (a, b))
    margin = np.full(MOST, meeting.margin)
    yield BoxEdges(one, other, half_a[None], half_b[None], origin_a, origin_b, margin, meeting.rough)


def points_back_on_shape(meeting: Meeting) -> Iterator[Candidates]:
    """Points of a rigid b against a's shape, unless a's balls tell all by themselves."""
    a, b = meeting.a, meeting.b
    if b is None or a.shape is None or b.shape is None or not a.shape.is_obstacle():
        return
    points = meeting.points_of(b)
    if len(points.radius) and not (b.shape.is_obstacle() and (a.is_ball or a.shape.swept)):
        yield _against(meeting, points, a.shape, a.number)


MAKERS: tuple[Callable[[Meeting], Iterator[Any]], ...] = (
    points_on_ground,
    ground_on_shape,
    nodes_on_surfaces,
    patches_on_each_other,
    points_on_shape,
    corners_on_surface,
    edges_on_edges,
    points_back_on_shape,
    curves_on_shapes,
    faces_on_shape,
    edges_on_surfaces,
)
"""What makes candidates of two partners, in the order of a group's entries; each yields none where it has no part."""


def _against(meeting: Meeting, points: Touching, shape: Shape, body: int | None) -> Candidates:
    """`points` against a shape: that of a rigid body, or ground."""
    count = len(points.radius)
    numbers = offset = None
    if body is not None:
        numbers = np.full(count, body, np.int32)
        offset = np.tile(meeting.bodies.rigid[body].properties[1], (count, 1))
    own = measured_by(meeting, shape, count, float(points.radius.max()))
    margin = meeting.margins(points)
    given = (points.points, points.radius, own, numbers, margin[:MOST_POINTS], meeting.rough, shape.shared)
    if count > MOST_POINTS and not isinstance(points.points, SoftPoint):
        return NearbyContacts(*given, offset=offset, most=MOST_POINTS)
    found = ShapeContacts(*given[:4], margin, *given[5:], offset=offset, **_at_edges(meeting, points, shape))
    return thinned(found, meeting.contact.per_node) if meeting.is_embedded(points) else found


def _at_edges(meeting: Meeting, points: Touching, shape: Shape) -> dict[str, Any]:
    """What tells nodes of a soft a which face of a solid with edges is theirs; nothing for others."""
    if not (isinstance(points.points, SoftPoint) and shape.is_solid()):
        return {}
    sharp = len(shape.circles()) or (shape.features()[1] == 0).any()
    around = triangles_around(points.points, meeting.surface(meeting.a)) if sharp else None
    return {} if around is None else {"around": around, "crease": shape.crease}


def _kind(candidates: Any) -> Any:
    """What the candidates of one group share: structure, flags and shapes but for their number."""
    leaves, structure = jax.tree.flatten(candidates.replace(names=(), cone=False))
    return structure, tuple(np.shape(leaf)[1:] for leaf in leaves)


def _joined(trees: list[Any], dtype: Any) -> Any:
    """Trees joined along their leading axis (a single one as it is), as arrays."""

    def join(*leaves: Any) -> jax.Array:
        array = np.concatenate([np.asarray(leaf) for leaf in leaves]) if len(leaves) > 1 else np.asarray(leaves[0])
        return on_device(array, device_type(array.dtype, dtype))

    bare = [tree.replace(names=()) if hasattr(tree, "names") else tree for tree in trees]
    joined = jax.tree.map(join, *bare)
    if hasattr(trees[0], "names"):
        joined = joined.replace(names=tuple(name for tree in trees for name in tree.names))
    return joined
