"""What frames show beside the soft bodies' mesh, one maker a part; a new one enters by `@frame_part(...)`."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described
from jaxfem.declared.scene import Scene
from jaxfem.loads import load_force
from jaxfem.model import Model, Params, State
from jaxfem.rigid.shapes import Shape
from jaxfem.rotation import quaternion_to_matrix
from jaxfem.rows.attachments import Configuration, SoftPoint
from jaxfem.rows.candidates import pairs_of
from jaxfem.rows.contact import tangents
from jaxfem.stepping import impulses
from jaxfem.system.coupled import configuration

Array = jax.Array


@dataclasses.dataclass(frozen=True)
class Part:
    """Points (n, 3) [m] and cells of one `kind` ("vertex", "line", "triangle"), (m, k) numbers of points, with values
    of points (n, ...) and of cells (m, ...) by name."""

    points: np.ndarray
    kind: str
    cells: np.ndarray
    nodal: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    cellwise: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Surface:
    """Triangles that move with rigid bodies or stand still: `points` (n, 3) [m] from the centre of mass, in the body's
    frame, of the rigid body `owner` (n,), -1 for the world's; `triangles` (t, 3); `number` (t,) of body or contact."""

    points: np.ndarray
    triangles: np.ndarray
    owner: np.ndarray
    number: np.ndarray


@dataclasses.dataclass(frozen=True)
class Shown:
    """What makers draw from: the built scene, the surfaces of its `rigid` bodies and its `ground`, tracked `points`
    (q, 3) [m] of the moment, and the time step `dt` [s], without which no forces are known; `skin`: embedded surfaces
    (`skins.py`)."""

    model: Model
    params: Params
    rigid: Surface
    ground: Surface
    dt: float | None
    skin: Any = None


Maker = Callable[[Shown, State, np.ndarray], Part | None]

CORNERS = {"vertex": 1, "line": 2, "triangle": 3}
"""Kinds of cells, with their number of points."""
PARTS: dict[str, Maker] = {}
"""All parts by name, in the order in which an index lists them."""


def frame_part(name: str) -> Callable[[Maker], Maker]:
    """Enter a function (shown, state, tracked points (q, 3)) -> Part, or None for scenes without such a thing."""

    def entered(make: Maker) -> Maker:
        if not name.isidentifier():
            raise ValueError(f'the part "{name}" of the frames goes into file names: give it letters and digits')
        PARTS[name] = make
        return make

    return entered


def parts_of(shown: Shown, state: State, points: np.ndarray) -> dict[str, Part]:
    """The parts that a scene has, by name; ValueError names one that is none."""
    found = {}
    for name, make in PARTS.items():
        part: Any = make(shown, state, points)
        if part is None:
            continue
        if not isinstance(part, Part) or part.kind not in CORNERS:
            given = described(part) if not isinstance(part, Part) else f'cells of the kind "{part.kind}"'
            raise ValueError(f'the part "{name}" gives {given}; it must give a Part of {", ".join(CORNERS)}, or None')
        counts = (np.shape(part.points), np.shape(part.cells))
        if counts[0][:1] == (0,):
            continue
        if len(counts[0]) != 2 or counts[0][1] != 3 or counts[1][1:] != (CORNERS[part.kind],):
            wanted = f"points (n, 3) and cells (m, {CORNERS[part.kind]})"
            raise ValueError(f'the part "{name}" has points {counts[0]} and cells {counts[1]}; it needs {wanted}')
        found[name] = part
    return found


def surfaces(scene: Scene | None, model: Model) -> tuple[Surface, Surface]:
    """Those of the rigid bodies and of the ground that a scene declares; empty ones without it."""
    bodies = [] if scene is None else scene.rigid
    solids = [(body.shape.outline(_box(model)), body.properties[1], i, i) for i, body in enumerate(bodies)]
    grounds = [] if scene is None else [(i, each.b) for i, each in enumerate(scene.contacts) if _is_ground(each.b)]
    box = _box(model, [points for (points, _), *_ in solids])
    return _gathered(solids), _gathered([(each.outline(box), np.zeros(3), -1, i) for i, each in grounds])


def _is_ground(partner: Any) -> bool:
    return isinstance(partner, Shape)


def _box(model: Model, shapes: list[np.ndarray] | None = None) -> np.ndarray:
    """A box (2, 3) [m] around all bodies at the start, twice as large as they are."""
    places = [np.asarray(model.rest, float)]
    if model.rigid is not None:
        centers = np.asarray(model.rigid.start, float)
        reach = [np.linalg.norm(points, axis=1).max(initial=0) for points in shapes or []]
        for reached, center in zip(reach, centers, strict=False):
            places += [center[None] - reached, center[None] + reached]
        places.append(centers)
    every = np.concatenate(places)
    low, high = every.min(0), every.max(0)
    half = max(float((high - low).max()), 1e-3)
    return np.stack([(low + high) / 2 - half, (low + high) / 2 + half])


def _gathered(given: list[tuple[tuple[np.ndarray, np.ndarray], np.ndarray, int, int]]) -> Surface:
    offset, parts = 0, [(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros(0, int), np.zeros(0, int))]
    for (points, triangles), center, owner, number in given:
        owners, numbers = np.full(len(points), owner), np.full(len(triangles), number)
        parts.append((points - center, triangles + offset, owners, numbers))
        offset += len(points)
    return Surface(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def forces_of(group: Any, label: str, given: Mapping[str, Array], normals: Array, dt: float) -> np.ndarray:
    """Forces (m, 3) [N] on a's side of a contact group, from the last impulses by name."""
    normal = given.get(f"contact {label}")
    total = np.zeros(normals.shape)
    if normal is not None:
        total += np.asarray(normals) * np.asarray(normal).reshape(-1, 1)
    across = given.get(f"contact {label} friction")
    if across is not None:
        total += np.einsum("mr,mri->mi", np.asarray(across), np.asarray(tangents(normals)))
    return total / dt


def places_of(group: Any, relative: Any, at: Configuration) -> np.ndarray:
    """Where pairs (m) are (m, 3) [m]: a's point, read off the coefficients of its velocity where it is not at hand.

    A node's block is its weight times 1, a rigid body's is 1 and then minus the arm's cross product.
    """
    held = getattr(group, "points", None)
    if isinstance(held, SoftPoint) and len(held.nodes) == len(relative.triples):
        return np.asarray(held.placed(at).position, float)
    triples, jacobian = np.asarray(relative.triples), np.asarray(relative.jacobian)
    nodes, centers = np.asarray(at.nodes), np.asarray(at.centers)
    blocks = jacobian.reshape(*jacobian.shape[:2], triples.shape[1], 3).transpose(0, 2, 1, 3)
    weight = np.maximum(np.trace(blocks, axis1=2, axis2=3) / 3, 0)
    fixed = np.concatenate([nodes, centers, np.zeros_like(centers)])
    places = np.einsum("mk,mki->mi", weight, fixed[triples])
    arms = np.stack([-blocks[..., 2, 1], -blocks[..., 0, 2], -blocks[..., 1, 0]], -1)
    linear = (triples >= len(nodes)) & (triples < len(nodes) + len(centers)) & (weight > 0)
    first = np.roll(linear, 1, axis=1)  # a body's angular triple follows its linear one
    first[:, 0] = False
    found: np.ndarray = places + np.where(first[..., None], arms, 0).sum(1)
    return found


@frame_part("rigid")
def rigid_bodies(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """Surfaces of the rigid bodies where they are, with their velocity [m/s] and number."""
    drawn, rigid, bodies = shown.rigid, state.rigid, shown.model.rigid
    if rigid is None or bodies is None or not len(drawn.triangles):
        return None
    places, arms = _posed(drawn, rigid.positions, rigid.orientations)
    first, _ = _posed(drawn, bodies.start, bodies.start_orientation)
    speeds, spin = (np.asarray(each, np.float64)[drawn.owner] for each in (rigid.velocities, rigid.angular_velocities))
    moved = {"displacement": places - first, "velocity": speeds + np.cross(spin, arms)}
    return Part(places, "triangle", drawn.triangles, moved, {"body": drawn.number})


def _posed(drawn: Surface, centers: Any, orientations: Any) -> tuple[np.ndarray, np.ndarray]:
    """Where the points of surfaces are (n, 3) [m], and how far from their bodies' centres."""
    turns = np.asarray(quaternion_to_matrix(orientations), np.float64)[drawn.owner]
    arms = np.einsum("nij,nj->ni", turns, drawn.points)
    return np.asarray(centers, np.float64)[drawn.owner] + arms, arms


@frame_part("ground")
def ground(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """Surfaces of what bodies touch and is no body, with the number of its contact."""
    drawn = shown.ground
    if not len(drawn.triangles):
        return None
    return Part(drawn.points, "triangle", drawn.triangles, {}, {"contact": drawn.number})


@frame_part("joints")
def joints(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """A line between the two points of each joint that has some, with its number and force, 0 where it is not known."""
    at, given = configuration(state), _impulses(shown, state)
    ends, names, pulls = [], list[str](), []
    for label, rows in shown.model.joints.items():
        held = [leaf for leaf in jax.tree.leaves(rows, is_leaf=_is_point) if _is_point(leaf)]
        if len(held) < 2:
            continue
        ends.append(np.stack([np.asarray(each.placed(at).position, float) for each in held[:2]], 1))
        names += rows.names
        impulse = given.get(f"joint {label}")
        force = np.zeros((len(ends[-1]), 1)) if impulse is None or not shown.dt else np.asarray(impulse) / shown.dt
        pulls.append(np.linalg.norm(force.reshape(len(ends[-1]), -1), axis=1))
    if not ends:
        return None
    places = np.concatenate(ends)
    cells = np.arange(2 * len(places)).reshape(-1, 2)
    known = list(dict.fromkeys(names))
    numbers = np.array([known.index(name) for name in names])
    return Part(places.reshape(-1, 3), "line", cells, {}, {"joint": numbers, "force": np.concatenate(pulls)})


@frame_part("contacts")
def contacts(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """Points where partners are within the contact's margin: gap [m], force on the first of them [N], its number."""
    groups = shown.model.contacts
    if not groups:
        return None
    at, given, rows = configuration(state), _impulses(shown, state), []
    every = list(dict.fromkeys(name for group in groups.values() for name in group.names))
    for label, pairs in _pairs(groups, at).items():
        group = groups[label]
        gap = np.asarray(pairs.gap, float)
        force = forces_of(group, label, given, pairs.normal, shown.dt) if shown.dt else np.zeros((len(gap), 3))
        numbers = np.array([every.index(name) for name in group.names])
        near = (gap < np.asarray(group.margin)) | (np.abs(force).max(1) > 0)
        values = places_of(group, pairs.relative, at), gap[:, None], force, numbers[:, None]
        rows.append(np.concatenate(values, axis=1)[near])
    found = np.concatenate(rows)
    count = np.arange(len(found))[:, None]
    nodal = {"gap": found[:, 3], "force": found[:, 4:7], "contact": found[:, 7].astype(int)}
    return Part(found[:, :3], "vertex", count, nodal)


@frame_part("loads")
def loads(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """Nodes on which loads act, with their forces [N]."""
    if not shown.model.loads:
        return None
    force = np.asarray(_loads(shown.model, shown.params, state.positions))
    nodes = np.flatnonzero(np.abs(force).max(1) > 0)
    return Part(np.asarray(state.positions)[nodes], "vertex", np.arange(len(nodes))[:, None], {"force": force[nodes]})


@frame_part("points")
def tracked(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """Tracked points and markers."""
    if not len(points):
        return None
    return Part(points, "vertex", np.arange(len(points))[:, None], {"point": np.arange(len(points))})


@frame_part("embedded")
def embedded(shown: Shown, state: State, points: np.ndarray) -> Part | None:
    """Vertices of contact surfaces that are embedded in soft bodies."""
    at, places = configuration(state), []
    for group in shown.model.contacts.values():
        held = getattr(group, "points", None)
        if isinstance(held, SoftPoint) and held.nodes.shape[1] == 4:
            places.append(np.asarray(held.placed(at).position, float))
    if not places:
        return None
    found = np.concatenate(places)
    return Part(found, "vertex", np.arange(len(found))[:, None])


def _impulses(shown: Shown, state: State) -> dict[str, Array]:
    return {} if shown.dt is None else impulses(shown.model, state)


def _is_point(leaf: Any) -> bool:
    return hasattr(leaf, "placed")


@jax.jit
def _pairs(groups: dict[str, Any], at: Configuration) -> dict[str, Any]:
    return {label: pairs_of(group, at) for label, group in groups.items()}


@jax.jit
def _loads(model: Model, params: Params, positions: Array) -> Array:
    return load_force(model.loads, params.loads, jnp.asarray(positions))
