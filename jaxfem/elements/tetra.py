"""Linear tetrahedra: constant shape gradients, deformation gradient, elastic strain in the element's rotated frame."""

from typing import Literal

import jax
import numpy as np

from jaxfem.pytrees import Pytree
from jaxfem.rotation import gram_schmidt_components, polar_components
from jaxfem.tensors import Matrix3, product, symmetric, to_eigenbasis, transposed

Array = jax.Array
RotationKind = Literal["polar", "gram_schmidt"]


class Elements(Pytree):
    """Tetrahedra of all bodies: `cells` (E, 4), `gradients` (4, 3, E) [1/m], `volumes` (E,) [m^3], `body` (E,)."""

    cells: Array
    gradients: Array
    volumes: Array
    body: Array

    @property
    def count(self) -> int:
        """Number of elements."""
        return self.cells.shape[0]


def shape_gradients(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the four linear shape functions (E, 4, 3) [1/m], and volumes (E,) [m^3]; host, float64."""
    corners = points[cells]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    inverse = np.linalg.inv(edges)
    return np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1), np.linalg.det(edges) / 6


def corner_differences(elements: Elements, field: Array) -> list[list[Array]]:
    """`field` (n, 3) at corners 1, 2, 3 less its value at corner 0: [corner][axis] of arrays (E,).

    Differences, because rigid motion then cancels before it is multiplied: float32 depends on it.
    """
    corners = [field[elements.cells[:, a]] for a in range(4)]
    return [[(corners[a] - corners[0])[:, i] for i in range(3)] for a in (1, 2, 3)]


def gradient_of(elements: Elements, field: Array) -> Matrix3:
    """Gradient of a nodal field (n, 3) in each element: sum_a field_a (x) grad N_a, as components (E,)."""
    differences = corner_differences(elements, field)
    g = elements.gradients
    return [
        [differences[0][i] * g[1, j] + differences[1][i] * g[2, j] + differences[2][i] * g[3, j] for j in range(3)]
        for i in range(3)
    ]


def deformation_gradient(elements: Elements, positions: Array) -> Matrix3:
    """F = dx/dX of each element, as components (E,)."""
    return gradient_of(elements, positions)


def rotation_of(deformation: Matrix3, kind: RotationKind) -> Matrix3:
    """Rotation of each element, as components: nearest rotation, or Gram-Schmidt on the columns (cheaper, coarser)."""
    return polar_components(deformation) if kind == "polar" else gram_schmidt_components(deformation)


def rotated_strain(deformation: Matrix3, rotation: Matrix3) -> list[Array]:
    """Elastic strain sym(R'F) - I in the element's own frame: six coefficients (E,) in the eigenbasis."""
    stretch = symmetric(product(transposed(rotation), deformation))
    return to_eigenbasis([[stretch[i][j] - (1.0 if i == j else 0.0) for j in range(3)] for i in range(3)])
