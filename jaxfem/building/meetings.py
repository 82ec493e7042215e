"""The two sides of a declared contact, found and checked: what touches with which points, and how far off."""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.building.embedded import embedded
from jaxfem.building.pressed import pressed_flat
from jaxfem.declared import Contact, SceneError
from jaxfem.rigid.shapes import Shape
from jaxfem.rigid.shapes.answers import distance_flaw, measured_flaw
from jaxfem.rows.attachments import RigidPoint, SoftPoint

MARGIN = 0.05  # of a's size
WIDTH = 8
"""Places for triangles around a node, or a multiple: so meshes share their programs."""


class Side(NamedTuple):
    """A body that touches: "soft" or "rigid", its number among those, and a rigid one's shape."""

    kind: str
    number: int
    shape: Shape | None

    @property
    def is_ball(self) -> bool:
        """Whether it touches with a single ball, so that one point tells all."""
        return self.shape is not None and len(self.shape.features()[0]) == 1


class Touching(NamedTuple):
    """Points (k) with which a body touches, and the radius (k,) [m] of the ball around each."""

    points: Any
    radius: np.ndarray


class Meeting(NamedTuple):
    """A contact's sides: `a` with its points, and a body `b` or else ground.

    `chosen`: the user chose a's points; `margin` [m]; `where`: words for messages; `dtype`: of the model.
    """

    contact: Contact
    bodies: BodyIndex
    a: Side
    points: Touching
    b: Side | None
    ground: Shape | None
    margin: float
    where: str
    dtype: Any

    @property
    def chosen(self) -> bool:
        """Whether the user chose the points of a that touch."""
        return self.contact.nodes is not None or self.contact.surface is not None

    @property
    def separation(self) -> float:
        """The contact's own, else a's size in a second [m/s]."""
        given = self.contact.separation
        return _size(self.bodies, self.a) if given is None else float(given)

    @property
    def rough(self) -> bool:
        """Whether there is friction."""
        return float(self.contact.friction) > 0

    def margins(self, points: Touching) -> np.ndarray:
        """The margin, once a point."""
        return np.full(len(points.radius), self.margin)

    def is_embedded(self, points: Touching) -> bool:
        """Whether they are vertices of a surface embedded in a soft body."""
        return self.contact.surface is not None and points is self.points

    def points_of(self, side: Side) -> Touching:
        """The points with which a body touches."""
        return _points(self.contact, self.bodies, side, self.where)

    @property
    def opposite(self) -> tuple[Shape | None, int | None]:
        """The shape that a meets, and the rigid body that it belongs to; None for ground, or for a soft b."""
        return (self.ground, None) if self.b is None else (self.b.shape, self.b.number)

    def faces(self) -> np.ndarray:
        """Triangles (t, 3) of a soft a's surface that touch, as nodes of the scene: those of chosen nodes alone."""
        none = self.contact.surface is not None
        return self.surface(self.a)[:0] if none else self.patch(self.points)

    def patch(self, points: Touching) -> np.ndarray:
        """Triangles (t, 3) of a soft a's surface whose corners are all among its nodes given."""
        triangles = self.surface(self.a)
        kept: np.ndarray = triangles[np.isin(triangles, points.points.nodes[:, 0]).all(1)]
        return kept

    def patches(self) -> list[tuple[Touching, np.ndarray]]:
        """Nodes of each of the two patches of a body that touches itself, and triangles of the other."""
        other = _nodes(self.contact.against, self.bodies, self.a.number, f"the patch `against` of {self.where}")
        found = [(self.points, self.patch(other)), (other, self.patch(self.points))]
        if np.isin(self.points.points.nodes, other.points.nodes).any():
            raise SceneError(f"{self.where}: the patches `nodes` and `against` share nodes; give two apart")
        if not all(len(triangles) for _, triangles in found):
            raise SceneError(f"{self.where}: a patch of `nodes` or `against` holds no whole triangle of the surface")
        return found

    def surface(self, side: Side) -> np.ndarray:
        """Triangles (t, 3) of a soft body's surface, as nodes of the scene."""
        triangles = self.bodies.soft[side.number].mesh.surface
        nodes: np.ndarray = (triangles + self.bodies.offsets[side.number]).astype(np.int32)
        return nodes


def bounds_at_corners(shape: Shape, ground: bool) -> bool:
    """Whether a shape ends, at its sharp points, away from its middle: solids do, but ground may be an open surface."""
    return shape.is_solid() and (shape.convex or not ground)


def triangles_around(points: Any, surface: np.ndarray) -> np.ndarray | None:
    """Triangles (m, f, 3) of a `surface` (t, 3) that hold all nodes of each of the points (m), which lie on it; padded
    with a triangle that has no area. None where they are not nodes of it, or of its edges."""
    nodes = points.nodes
    if nodes.shape[1] > 2:
        return None
    order = np.argsort(surface.ravel(), kind="stable")
    sorted_nodes = surface.ravel()[order]
    low, high = (np.searchsorted(sorted_nodes, nodes[:, 0], side=side) for side in ("left", "right"))
    most = int((high - low).max())
    places = low[:, None] + np.arange(-(-most // WIDTH) * WIDTH)
    found = surface[order[np.minimum(places, len(order) - 1)] // 3]
    held = (found[:, :, None, :] == nodes[:, None, :, None]).any(-1).all(-1) & (places < high[:, None])
    around: np.ndarray = np.where(held[:, :, None], found, nodes[:, :1, None]).astype(np.int32)
    return around


def meeting_of(contact: Contact, index: BodyIndex, where: str, dtype: Any) -> Meeting:
    """The sides of a contact; SceneError for two that cannot touch."""
    a = _side(index, contact.a, where)
    if a.kind == "rigid" and (contact.nodes is not None or contact.surface is not None):
        what = "a surface, which is embedded in" if contact.nodes is None else "nodes, which belong to"
        raise SceneError(f"{where} names {what} a soft body: make that one `a`")
    points = _points(contact, index, a, where)
    margin = MARGIN * _size(index, a) if contact.margin is None else float(contact.margin)
    ground = contact.b if isinstance(contact.b, Shape) else None
    b = _side(index, contact.b, where) if ground is None else None
    if b is not None:
        _check(contact, a, b, index, where)
    return Meeting(contact, index, a, points, b, ground, margin, where, dtype)


def _side(index: BodyIndex, body: Any, where: str) -> Side:
    kind, number = index.find(body, where)
    return Side(kind, number, index.rigid[number].shape if kind == "rigid" else None)


def _check(contact: Contact, a: Side, b: Side, index: BodyIndex, where: str) -> None:
    if a == b:
        if a.kind == "rigid" or contact.nodes is None or contact.against is None:
            raise SceneError(
                f"{where} names one body twice: only a soft body touches itself, with two patches of its surface, "
                "`nodes` and `against`"
            )
        return
    if contact.against is not None:
        raise SceneError(f"{where} has `against`, which is for a body that touches itself: there `b` is `a`")
    if b.shape is None:
        if a.kind == "rigid":
            raise SceneError(f"{where}: put the soft body first, Contact(soft, rigid)")
        return
    if not b.shape.is_obstacle() and (a.shape is None or not a.shape.is_obstacle()):
        raise SceneError(
            f'{where}: "{index.rigid[b.number].label}" is a {type(b.shape).__name__}, which others cannot touch with '
            "points: it has no distance; give the shape one, or a TriangleMesh in its place"
        )


def _points(contact: Contact, index: BodyIndex, side: Side, where: str) -> Touching:
    if side.shape is None:
        return _soft_points(contact, index, side.number, where)
    places, radius = side.shape.features()
    local = places - index.rigid[side.number].properties[1]
    return Touching(RigidPoint(np.full(len(local), side.number, np.int32), local), radius)


def _soft_points(contact: Contact, index: BodyIndex, number: int, where: str) -> Touching:
    body = index.soft[number]
    if contact.surface is not None:
        surface = contact.surface
        if surface is True:
            if body.surface is None:
                raise SceneError(f'{where} touches with the surface of "{body.label}", which has none: declare one')
            surface = body.surface[0]
        cells, weights = embedded(body.mesh, surface, f'surface of {where}, in "{body.label}"')
        return Touching(SoftPoint((cells + index.offsets[number]).astype(np.int32), weights), np.zeros(len(cells)))
    if contact.nodes is None and isinstance(contact.b, Shape) and pressed_flat(body, index.gravity):
        return _nodes("all", index, number, where)
    return _nodes(body.mesh.surface_nodes if contact.nodes is None else contact.nodes, index, number, where)


def _nodes(selection: Any, index: BodyIndex, number: int, where: str) -> Touching:
    chosen = index.soft[number].nodes_of("nodes of a contact", selection)
    if not len(chosen):
        raise SceneError(f"{where} touches with no node: its selection of nodes is empty")
    nodes = (np.asarray(chosen)[:, None] + index.offsets[number]).astype(np.int32)
    return Touching(SoftPoint(nodes, np.ones(nodes.shape)), np.zeros(len(nodes)))


def _size(index: BodyIndex, side: Side) -> float:
    if side.shape is None:
        return float(np.ptp(index.soft[side.number].mesh.points, axis=0).max())
    return float(np.ptp(side.shape.extent(), axis=0).max())


def measured_by(meeting: Meeting, shape: Shape, count: int, reach: float = 0.0) -> Any:
    """What a contact takes distances of a shape from, its values once for each of `count` pairs, or `shared` by all.

    SceneError for what has no distance that can be used. `reach` [m]: see `Shape.measured`.
    """
    measured = shape.measured(reach)
    flaw = measured_flaw(measured)
    if not flaw:
        flaw = distance_flaw(measured if shape.shared else repeated(measured, None), meeting.dtype)
    if flaw:
        raise SceneError(f"{meeting.where} touches a {type(shape).__name__}: {flaw}")
    return measured if shape.shared else repeated(measured, count)


def repeated(shape: Any, count: int | None) -> Any:
    """A shape's values as arrays, once for each of `count` pairs; once alone where that is None. Flags stay flags."""

    def one(value: Any) -> np.ndarray:
        array = np.asarray(value)
        array = array if array.dtype == np.bool_ else array.astype(float)
        return array if count is None else np.broadcast_to(array, (count, *array.shape))

    return jax.tree.map(one, shape, is_leaf=lambda v: isinstance(v, tuple | list | np.ndarray))
