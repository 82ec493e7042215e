"""Markers: points that ride on a body, on its surface or standing proud of it."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.batching import one_program
from jaxfem.elements.barycentric import foot_weights
from jaxfem.elements.reshaping import reshaped_elements
from jaxfem.elements.tetra import Elements, shape_gradients
from jaxfem.fitting.errors import FitError
from jaxfem.mesh import TetMesh, locate
from jaxfem.model import Model, State
from jaxfem.pytrees import Pytree, static
from jaxfem.rotation import nearest_rotation, quaternion_to_matrix
from jaxfem.tensors import contract

Array = jax.Array

NOTHING = 1e-9
"""Weight below which a corner has no part in the surface point beneath a marker."""


class Riders(Pytree):
    """Points carried by rigid bodies: numbers `body` (m,), places `local` (m, 3) [m] from their centres of mass, in
    their frames; `start` (m, 4): the bodies' orientations where the places were given."""

    body: Array
    local: Array
    start: Array


class Markers(Pytree):
    """Points carried by elements: `cells` (M, 4) nodes and `weights` (M, 4) of the surface point beneath, `offsets`
    (M, 3) [m] from it at rest, `gradients` (M, 4, 3) [1/m] of the element's shape functions, `names`.

    `riders`: those on rigid bodies, None without; `order`: where each of `names` is among the M, then the riders."""

    cells: Array
    weights: Array
    offsets: Array
    gradients: Array
    names: tuple[str, ...] = static(default=())
    riders: Riders | None = None
    order: tuple[int, ...] = static(default=())

    @property
    def count(self) -> int:
        """Number of markers."""
        return len(self.names)

    def reshaped(self, rest: Array, places: Array | None = None) -> "Markers":
        """The markers on a body whose nodes are at `rest` (n, 3) [m], undeformed: they ride with their elements, or are
        put at `places` (M, 3) [m] beside or in the same elements; pure, differentiable in both."""
        corners = rest[self.cells]
        gradients = _gradients(corners)
        if places is None:
            turn = nearest_rotation(contract("mai,maj->mij", corners, self.gradients))
            return self.replace(gradients=gradients, offsets=contract("mij,mj->mi", turn, self.offsets))
        weights = foot_weights(corners, places, jnp.abs(self.weights) > NOTHING)
        outside = jnp.any(self.offsets != 0, axis=1, keepdims=True)
        offsets = jnp.where(outside, places - contract("ma,mai->mi", weights, corners), 0)
        return self.replace(weights=weights, offsets=offsets, gradients=gradients)


def attach(body: TetMesh | Model, places: Mapping[str, Any]) -> Markers:
    """Fix markers to a body at rest: `places` name -> (3,) [m] in the body's frame.

    A place inside gets the weights of its element; one outside those of the nearest surface point, and an offset that
    turns with the element there. ("block", (3,)) puts one on the rigid body of that name, at a place of the world where
    the scene starts; in a scene of one rigid body alone every marker is on it. FitError for no marker, a place that is
    not three numbers, or one farther from the body than the body is long (a slip of units or of frame).
    """
    if not places:
        raise FitError("no marker is given: name at least one with its place, like {'tip': (0.1, 0.015, 0.03)}")
    if not isinstance(body, Model) or body.rigid is None:
        return _on_elements(body, places)
    owners = {name: _owner(name, place, body) for name, place in places.items()}
    soft = {name: place for name, place in places.items() if owners[name][0] is None}
    carried = {name: owner for name, owner in owners.items() if owner[0] is not None}
    if not carried:
        return _on_elements(body, places)
    markers = _on_elements(body, soft) if soft else _nothing(body)
    listed = [*soft, *carried]
    order = tuple(listed.index(name) for name in places)
    return markers.replace(names=tuple(places), riders=_riders(body, carried), order=order)


def carried(markers: Markers) -> dict[str, int]:
    """The numbers of the rigid bodies that markers are on, by the markers' names."""
    if markers.riders is None:
        return {}
    bodies, first = np.asarray(markers.riders.body), len(markers.cells)
    return {name: int(bodies[at - first]) for name, at in zip(markers.names, markers.order, strict=True) if at >= first}


def _owner(name: str, place: Any, model: Model) -> tuple[int | None, Any]:
    """The number of the rigid body that a marker is on, None for elements; and its place."""
    assert model.rigid is not None
    named = isinstance(place, tuple | list) and len(place) == 2 and isinstance(place[0], str)
    if not named:
        if model.bodies:
            return None, place
        if model.rigid.count == 1:
            return 0, place
        raise FitError(
            f'marker "{name}" does not say which rigid body it is on: give ("NAME", place), of '
            + ", ".join(model.rigid.names)
        )
    if place[0] not in model.rigid.names:
        raise FitError(f'marker "{name}" is on "{place[0]}", no rigid body: there are {", ".join(model.rigid.names)}')
    return model.rigid.names.index(place[0]), place[1]


def _riders(model: Model, carried: Mapping[str, tuple[int | None, Any]]) -> Riders:
    assert model.rigid is not None
    size, local, numbers = float(np.asarray(model.size)), [], []
    turns = np.asarray(quaternion_to_matrix(model.rigid.start_orientation), np.float64)
    for name, (number, place) in carried.items():
        array = np.asarray(place, np.float64) if np.shape(place) == (3,) else np.full(3, np.nan)
        if not np.isfinite(array).all():
            raise FitError(f'the place of marker "{name}" is {place!r}; give three finite numbers in m')
        arm = array - np.asarray(model.rigid.start[number], np.float64)
        if np.linalg.norm(arm) > 2 * size:
            raise FitError(
                f'marker "{name}" lies {np.linalg.norm(arm):.3g} m from the centre of its rigid body, in a scene that '
                f"is {size:.3g} m long: give its place in the world, in m"
            )
        local.append(turns[number].T @ arm)
        numbers.append(number)
    bodies = np.array(numbers)
    start = jnp.asarray(np.asarray(model.rigid.start_orientation)[bodies], model.rest.dtype)
    return Riders(jnp.asarray(bodies, jnp.int32), jnp.asarray(np.array(local), model.rest.dtype), start)


def _nothing(model: Model) -> Markers:
    dtype = model.rest.dtype
    return Markers(
        jnp.zeros((0, 4), jnp.int32), jnp.zeros((0, 4), dtype), jnp.zeros((0, 3), dtype), jnp.zeros((0, 4, 3), dtype)
    )


def _on_elements(body: TetMesh | Model, places: Mapping[str, Any]) -> Markers:
    points, cells = _geometry(body)
    for name, place in places.items():
        array = np.asarray(place, dtype=np.float64)
        if array.shape != (3,) or not np.isfinite(array).all():
            raise FitError(f'the place of marker "{name}" is {place!r}; give three finite numbers in m')
    queries = np.array([np.asarray(place, dtype=np.float64) for place in places.values()])
    found, weights, distance = locate(points, cells, queries)
    size = float(np.ptp(points, axis=0).max())
    for name, away in zip(places, distance, strict=True):
        if away > size:
            raise FitError(
                f'marker "{name}" lies {away:.3g} m from the body, which is {size:.3g} m long: give places in m, '
                "in the frame of the mesh"
            )
    corners = cells[found]
    beneath = np.einsum("ma,mai->mi", weights, points[corners])
    offsets = np.where(distance[:, None] > 0, queries - beneath, 0.0)
    dtype = body.rest.dtype if isinstance(body, Model) else jnp.zeros(()).dtype
    gradients = shape_gradients(points, corners)[0]
    return Markers(
        jnp.asarray(corners, jnp.int32),
        jnp.asarray(weights, dtype),
        jnp.asarray(offsets, dtype),
        jnp.asarray(gradients, dtype),
        names=tuple(places),
    )


@one_program
def marker_positions(markers: Markers, positions: Array) -> Array:
    """Where the markers are: nodes' positions (..., n, 3) -> (..., M, 3) [m]; differentiable in both arguments.

    x = sum_a w_a x_a + R o, R the nearest rotation of the element's deformation gradient, o the offset at rest.
    """
    corners = positions[..., markers.cells, :]
    beneath = contract("ma,...mai->...mi", markers.weights, corners)
    # differences from one corner, so that rigid motion cancels before it is multiplied
    edges = corners[..., 1:, :] - corners[..., :1, :]
    deformation = contract("...mai,maj->...mij", edges, markers.gradients[:, 1:])
    return beneath + contract("...mij,mj->...mi", nearest_rotation(deformation), markers.offsets)


@one_program
def marker_places(markers: Markers, state: State) -> Array:
    """Where the markers are in a state, or in states with leading axes: (..., M, 3) [m]; differentiable.

    Those on rigid bodies: x = c + R l, c the centre of mass.
    """
    soft = marker_positions(markers, state.positions) if markers.cells.shape[0] else None
    if markers.riders is None or state.rigid is None:
        assert soft is not None
        return soft
    turns = quaternion_to_matrix(state.rigid.orientations[..., markers.riders.body, :])
    carried = state.rigid.positions[..., markers.riders.body, :] + contract(
        "...mij,mj->...mi", turns, markers.riders.local
    )
    every = carried if soft is None else jnp.concatenate([soft, carried], axis=-2)
    return every[..., np.array(markers.order), :]


@one_program
def marker_frames(markers: Markers, state: State) -> Array:
    """How small shifts of the markers' places at rest move them: (..., M, 3, 3); differentiable.

    The deformation gradient of the element for one inside, and of one outside or on a rigid body the rotation.
    """
    soft = None
    if markers.cells.shape[0]:
        corners = state.positions[..., markers.cells, :]
        edges = corners[..., 1:, :] - corners[..., :1, :]
        soft = contract("...mai,maj->...mij", edges, markers.gradients[:, 1:])
        outside = jnp.any(markers.offsets != 0, axis=1)[:, None, None]
        soft = jnp.where(outside, nearest_rotation(soft), soft)
    if markers.riders is None or state.rigid is None:
        assert soft is not None
        return soft
    now = quaternion_to_matrix(state.rigid.orientations[..., markers.riders.body, :])
    carried = now @ jnp.swapaxes(quaternion_to_matrix(markers.riders.start), -1, -2)
    every = carried if soft is None else jnp.concatenate([soft, carried], axis=-3)
    return every[..., np.array(markers.order), :, :]


def moved_places(markers: Markers, shifts: Array) -> Markers:
    """Markers whose places at rest are off by `shifts` (M, 3) [m], in the order of their names, and small: those inside
    stay with their elements. Traceable; `moved_markers` finds the elements anew."""
    order = np.argsort(markers.order) if markers.order else np.arange(markers.count)
    listed, soft = shifts[order], markers.cells.shape[0]
    outside = jnp.any(markers.offsets != 0, axis=1, keepdims=True)
    own = listed[:soft]
    weights = markers.weights + jnp.where(outside, 0.0, contract("mai,mi->ma", markers.gradients, own))
    moved = markers.replace(weights=weights, offsets=markers.offsets + jnp.where(outside, own, 0.0))
    if markers.riders is None:
        return moved
    turns = quaternion_to_matrix(markers.riders.start)
    local = markers.riders.local + contract("mji,mj->mi", turns, listed[soft:])
    return moved.replace(riders=markers.riders.replace(local=local))


def moved_markers(markers: Markers, model: Model, shifts: np.ndarray) -> Markers:
    """Markers whose places at rest are off by `shifts` (M, 3) [m], in the order of their names."""
    inverse = np.argsort(markers.order) if markers.order else np.arange(markers.count)
    soft = markers.cells.shape[0]
    listed = np.asarray(shifts)[inverse]
    if soft:
        at = np.einsum("ma,mai->mi", np.asarray(markers.weights), np.asarray(model.rest)[np.asarray(markers.cells)])
        places = at + np.asarray(markers.offsets) + listed[:soft]
        names = [markers.names[k] for k in inverse[:soft]]
        new = _on_elements(model, dict(zip(names, places, strict=True)))
        markers = new.replace(names=markers.names, riders=markers.riders, order=markers.order)
    if markers.riders is None or model.rigid is None:
        return markers
    turns = np.asarray(quaternion_to_matrix(model.rigid.start_orientation))[np.asarray(markers.riders.body)]
    local = markers.riders.local + np.einsum("mji,mj->mi", turns, listed[soft:])
    return markers.replace(riders=markers.riders.replace(local=jnp.asarray(local, markers.riders.local.dtype)))


def _gradients(corners: Array) -> Array:
    """Gradients (M, 4, 3) of the shape functions of elements with `corners` (M, 4, 3)."""
    cells = jnp.arange(corners.shape[0] * 4, dtype=jnp.int32).reshape(-1, 4)
    empty = Elements(cells, jnp.zeros(0), jnp.zeros(0), jnp.zeros(0, jnp.int32))
    return reshaped_elements(empty, corners.reshape(-1, 3)).gradients.transpose(2, 0, 1)


def _geometry(body: TetMesh | Model) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(body, Model):
        return np.asarray(body.rest, dtype=np.float64), np.asarray(body.elements.cells, dtype=np.int64)
    return np.asarray(body.points), np.asarray(body.cells)
