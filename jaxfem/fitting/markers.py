"""Markers: points that ride on a body, on its surface or standing proud of it."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.elements.barycentric import foot_weights
from jaxfem.elements.reshaping import reshaped_elements
from jaxfem.elements.tetra import Elements, shape_gradients
from jaxfem.fitting.errors import FitError
from jaxfem.mesh import TetMesh, locate
from jaxfem.model import Model
from jaxfem.pytrees import Pytree, static
from jaxfem.rotation import nearest_rotation

Array = jax.Array

NOTHING = 1e-9
"""Weight below which a corner has no part in the surface point beneath a marker."""


class Markers(Pytree):
    """Points carried by elements: `cells` (M, 4) nodes and `weights` (M, 4) of the surface point beneath, `offsets`
    (M, 3) [m] from it at rest, `gradients` (M, 4, 3) [1/m] of the element's shape functions, `names`."""

    cells: Array
    weights: Array
    offsets: Array
    gradients: Array
    names: tuple[str, ...] = static()

    @property
    def count(self) -> int:
        """Number of markers."""
        return self.cells.shape[0]

    def reshaped(self, rest: Array, places: Array | None = None) -> "Markers":
        """The markers on a body whose nodes are at `rest` (n, 3) [m], undeformed: they ride with their elements, or are
        put at `places` (M, 3) [m] beside or in the same elements; pure, differentiable in both."""
        corners = rest[self.cells]
        gradients = _gradients(corners)
        if places is None:
            turn = nearest_rotation(jnp.einsum("mai,maj->mij", corners, self.gradients))
            return self.replace(gradients=gradients, offsets=jnp.einsum("mij,mj->mi", turn, self.offsets))
        weights = foot_weights(corners, places, jnp.abs(self.weights) > NOTHING)
        outside = jnp.any(self.offsets != 0, axis=1, keepdims=True)
        offsets = jnp.where(outside, places - jnp.einsum("ma,mai->mi", weights, corners), 0)
        return self.replace(weights=weights, offsets=offsets, gradients=gradients)


def attach(body: TetMesh | Model, places: Mapping[str, Any]) -> Markers:
    """Fix markers to a body at rest: `places` name -> (3,) [m] in the body's frame.

    A place inside gets the weights of its element; one outside those of the nearest surface point, and an offset that
    turns with the element there. FitError for no marker, a place that is not three numbers, or one farther from the
    body than the body is long (a slip of units or of frame).
    """
    if not places:
        raise FitError("no marker is given: name at least one with its place, like {'tip': (0.1, 0.015, 0.03)}")
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


def marker_positions(markers: Markers, positions: Array) -> Array:
    """Where the markers are: nodes' positions (..., n, 3) -> (..., M, 3) [m]; differentiable in both arguments.

    x = sum_a w_a x_a + R o, R the nearest rotation of the element's deformation gradient, o the offset at rest.
    """
    corners = positions[..., markers.cells, :]
    beneath = jnp.einsum("ma,...mai->...mi", markers.weights, corners)
    # differences from one corner, so that rigid motion cancels before it is multiplied
    edges = corners[..., 1:, :] - corners[..., :1, :]
    deformation = jnp.einsum("...mai,maj->...mij", edges, markers.gradients[:, 1:])
    return beneath + jnp.einsum("...mij,mj->...mi", nearest_rotation(deformation), markers.offsets)


def _gradients(corners: Array) -> Array:
    """Gradients (M, 4, 3) of the shape functions of elements with `corners` (M, 4, 3)."""
    cells = jnp.arange(corners.shape[0] * 4, dtype=jnp.int32).reshape(-1, 4)
    empty = Elements(cells, jnp.zeros(0), jnp.zeros(0), jnp.zeros(0, jnp.int32))
    return reshaped_elements(empty, corners.reshape(-1, 3)).gradients.transpose(2, 0, 1)


def _geometry(body: TetMesh | Model) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(body, Model):
        return np.asarray(body.rest, dtype=np.float64), np.asarray(body.elements.cells, dtype=np.int64)
    return np.asarray(body.points), np.asarray(body.cells)
