"""Linear tetrahedra: constant shape gradients, deformation gradient, elastic strain in the element's rotated frame."""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.indexing import gather
from jaxfem.pytrees import Pytree
from jaxfem.rotation import gram_schmidt_components, polar_components
from jaxfem.tensors import Matrix3, matrix_of, product, symmetric, to_eigenbasis, transposed

Array = jax.Array
RotationKind = Literal["polar", "gram_schmidt"]


def has_energy(kind: RotationKind) -> bool:
    """Whether the elastic forces of elements turned so have an energy: with the nearest rotation alone."""
    return kind == "polar"


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


def tetra_gradient(cells: Array, gradients: Array, field: Array) -> Matrix3:
    """Gradient of a nodal field (n, 3) in tetrahedra: sum_a field_a (x) grad N_a, as components (E,).

    `cells` (E, 4), `gradients` (4, 3, E). From differences to the first corner: rigid motion cancels before it is
    multiplied, and float32 depends on that.
    """
    # Written out: twice as fast on a CPU as a product. The barrier keeps XLA from gathering anew for each entry.
    along = field.T
    corners = jnp.stack([gather(along[i], cells.T) for i in range(3)])
    difference = jax.lax.optimization_barrier(corners[:, 1:] - corners[:, :1])
    parts = (difference[:, a, None] * gradients[a + 1] for a in (1, 2))
    return matrix_of(sum(parts, start=difference[:, 0, None] * gradients[1]))


def deformation_gradient(elements: Elements, positions: Array) -> Matrix3:
    """F = dx/dX of each element, as components (E,)."""
    return tetra_gradient(elements.cells, elements.gradients, positions)


def rotation_of(deformation: Matrix3, kind: RotationKind) -> Matrix3:
    """Rotation of each element, as components: nearest rotation, or Gram-Schmidt on the columns (cheaper, coarser)."""
    return polar_components(deformation) if kind == "polar" else gram_schmidt_components(deformation)


def rotated_strain(deformation: Matrix3, rotation: Matrix3) -> list[Array]:
    """Elastic strain sym(R'F) - I in the element's own frame: six coefficients (E,) in the eigenbasis."""
    stretch = symmetric(product(transposed(rotation), deformation))
    return to_eigenbasis([[stretch[i][j] - (1.0 if i == j else 0.0) for j in range(3)] for i in range(3)])
