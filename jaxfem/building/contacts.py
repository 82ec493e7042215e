"""Declared contacts as groups of candidates: all pairs of one kind in one set of arrays."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.building.bodies import BodyIndex
from jaxfem.building.embedded import embedded
from jaxfem.declared import Contact, SceneError
from jaxfem.rigid.shapes import Box, HeightField, Plane, SignedDistance, TriangleMesh
from jaxfem.rows.attachments import RigidPoint, SoftPoint
from jaxfem.rows.box_edges import MOST, BoxEdges
from jaxfem.rows.contact import ContactValues, ShapeContacts, SurfaceContacts

GROUND = (Plane, HeightField, SignedDistance)
MARGIN = 0.05  # of a's size


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
        for candidates in _candidates(contact, index, where):
            count = len(candidates.margin)
            values = ContactValues(np.full(count, contact.friction), np.full(count, contact.restitution))
            label = f"{'rough' if candidates.rough else 'smooth'} {candidates.kind}"
            if isinstance(candidates, ShapeContacts) and candidates.shared:
                label = f"{label} {name}"
            grouped.setdefault(label, []).append((candidates.replace(names=(name,) * count), values))
    rows = {label: _joined([each for each, _ in parts], dtype) for label, parts in grouped.items()}
    return rows, {label: _joined([each for _, each in parts], dtype) for label, parts in grouped.items()}


def _joined(trees: list[Any], dtype: Any) -> Any:
    """Trees joined along their leading axis (a single one as it is), as arrays."""

    def join(*leaves: Any) -> jax.Array:
        array = np.concatenate([np.asarray(leaf) for leaf in leaves]) if len(leaves) > 1 else np.asarray(leaves[0])
        return jnp.asarray(array, jnp.int32 if np.issubdtype(array.dtype, np.integer) else dtype)

    bare = [tree.replace(names=()) if hasattr(tree, "names") else tree for tree in trees]
    joined = jax.tree.map(join, *bare)
    if hasattr(trees[0], "names"):
        joined = joined.replace(names=tuple(name for tree in trees for name in tree.names))
    return joined


def _candidates(contact: Contact, index: BodyIndex, where: str) -> Iterator[Any]:
    kind, a = index.find(contact.a, where)
    rough = float(contact.friction) > 0
    points: Any
    if kind == "soft":
        points, radius = _soft_points(contact, index, a, where)
    elif contact.nodes is not None or contact.surface is not None:
        what = "a surface, which is embedded in" if contact.nodes is None else "nodes, which belong to"
        raise SceneError(f"{where} names {what} a soft body: make that one `a`")
    else:
        points, radius = _rigid_points(index, a)
    size = _size(index, kind, a)
    margin = np.full(len(radius), MARGIN * size if contact.margin is None else contact.margin)
    if isinstance(contact.b, GROUND):
        yield _ground(contact.b, points, radius, margin, rough)
        return
    other, b = index.find(contact.b, where)
    if (kind, a) == (other, b):
        raise SceneError(f"{where} names one body twice: a body does not touch itself here")
    if other == "soft" and kind == "rigid":
        raise SceneError(f"{where}: put the soft body first, Contact(soft, rigid)")
    if other == "soft":
        yield _soft_pair(points, index, b, margin[0], rough)
        if contact.nodes is None and contact.surface is None:
            yield _soft_pair(_soft_points(contact, index, b, where)[0], index, a, margin[0], rough)
        return
    shape = index.rigid[b].shape
    if isinstance(shape, TriangleMesh):
        if kind == "soft" or isinstance(index.rigid[a].shape, TriangleMesh):
            raise SceneError(
                f'{where}: "{index.rigid[b].label}" is a triangle mesh, which others cannot touch with points'
            )
    else:
        yield _against(index, points, radius, margin, b, rough)
    if kind == "rigid" and isinstance(shape, Box) and isinstance(index.rigid[a].shape, Box):
        yield _box_edges(index, a, b, margin[0], rough)
    if kind == "rigid" and not _round(index, a) and not _round(index, b):
        back, radii = _rigid_points(index, b)
        yield _against(index, back, radii, np.full(len(radii), margin[0]), a, rough)
    elif kind == "rigid" and isinstance(shape, TriangleMesh):
        back, radii = _rigid_points(index, b)
        yield _against(index, back, radii, np.full(len(radii), margin[0]), a, rough)


def _round(index: BodyIndex, number: int) -> bool:
    """Whether a body touches with a single ball, so that one point tells all."""
    return len(index.rigid[number].shape.features()[0]) == 1


def _ground(shape: Any, points: Any, radius: np.ndarray, margin: np.ndarray, rough: bool) -> ShapeContacts:
    shared = not isinstance(shape, Plane)
    return ShapeContacts(
        points, radius, shape if shared else _repeated(shape, len(radius)), None, margin, rough, shared
    )


def _against(index: BodyIndex, points: Any, radius: Any, margin: Any, body: int, rough: bool) -> ShapeContacts:
    count = len(radius)
    shape = _repeated(index.rigid[body].shape, count)
    return ShapeContacts(points, radius, shape, np.full(count, body, np.int32), margin, rough, False)


def _box_edges(index: BodyIndex, a: int, b: int, margin: float, rough: bool) -> BoxEdges:
    half_a, origin_a = _block(index.rigid[a])
    half_b, origin_b = _block(index.rigid[b])
    one, other = np.full(1, a, np.int32), np.full(1, b, np.int32)
    return BoxEdges(one, other, half_a, half_b, origin_a, origin_b, np.full(MOST, margin), rough)


def _block(body: Any) -> tuple[np.ndarray, np.ndarray]:
    """Halves of a box's size, and its origin from the centre of mass, (1, 3) each."""
    return np.asarray(body.shape.size, float)[None] / 2, -body.properties[1][None]


def _soft_pair(points: SoftPoint, index: BodyIndex, b: int, margin: float, rough: bool) -> SurfaceContacts:
    triangles = (index.soft[b].mesh.surface + index.offsets[b]).astype(np.int32)
    each = np.broadcast_to(triangles, (len(points.nodes), *triangles.shape))
    return SurfaceContacts(points, each, np.full(len(points.nodes), margin), rough)


def _soft_points(contact: Contact, index: BodyIndex, number: int, where: str) -> tuple[SoftPoint, np.ndarray]:
    body = index.soft[number]
    if contact.surface is not None:
        cells, weights = embedded(body.mesh, contact.surface, f'surface of {where}, in "{body.label}"')
        return SoftPoint((cells + index.offsets[number]).astype(np.int32), weights), np.zeros(len(cells))
    chosen = body.mesh.surface_nodes if contact.nodes is None else body.nodes_of("nodes of a contact", contact.nodes)
    if not len(chosen):
        raise SceneError(f"{where} touches with no node: its selection of nodes is empty")
    nodes = (np.asarray(chosen)[:, None] + index.offsets[number]).astype(np.int32)
    return SoftPoint(nodes, np.ones(nodes.shape)), np.zeros(len(nodes))


def _rigid_points(index: BodyIndex, number: int) -> tuple[RigidPoint, np.ndarray]:
    body = index.rigid[number]
    places, radius = body.shape.features()
    local = places - body.properties[1]
    return RigidPoint(np.full(len(local), number, np.int32), local), radius


def _size(index: BodyIndex, kind: str, number: int) -> float:
    if kind == "soft":
        return float(np.ptp(index.soft[number].mesh.points, axis=0).max())
    places, radius = index.rigid[number].shape.features()
    return float(np.ptp(places, axis=0).max() + 2 * radius.max())


def _repeated(shape: Any, count: int) -> Any:
    return jax.tree.map(
        lambda v: np.broadcast_to(np.asarray(v, float), (count, *np.shape(v))),
        shape,
        is_leaf=lambda v: isinstance(v, tuple | list | np.ndarray),
    )
