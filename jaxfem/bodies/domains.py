"""Smoothing domains: the pieces of a body on which one strain is taken. An element is the plainest of them.

The mean deformation gradient over the elements around a node or an edge, weighted by their shares of volume, has one
rotation and one strain; so a domain is a tetrahedron with more corners, and every kernel that serves one serves both.
Smoothing over nodes: Bonet & Burton 1998; over edges, and both at once: Nguyen-Thoi, Liu, Lam & Zhang 2009.
"""

from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp

from jaxfem.bodies.elements import RotationKind, rotated_strain, rotation_of
from jaxfem.bodies.material import eigenstiffness
from jaxfem.pytrees import pytree, static
from jaxfem.tensors import Matrix3, array_of, from_eigenbasis, matrix_of, product

Array = jax.Array
Part = Literal["full", "deviatoric", "volumetric"]


@pytree
class Domains:
    """Domains of one kind, and the part of the strain that is taken on them; arrays over D domains of up to m nodes.

    Domains of more nodes come first. `cells` (D, m), in the solver's order of nodes, padded by repeating the first;
    `gradients` (m, 3, D) [1/m]: of the mean deformation gradient in the nodes' places, 0 on padding; `volumes` (D,)
    [m^3]; `body` (D,). `members` (D, k) and `shares` (D, k): elements averaged over and their shares of the volume;
    None where domain d is element d.
    """

    cells: Array
    gradients: Array
    volumes: Array
    body: Array
    members: Array | None
    shares: Array | None
    part: Part = static()

    @property
    def count(self) -> int:
        """Number of domains."""
        return self.cells.shape[0]

    @property
    def rows(self) -> slice:
        """Which of the six coefficients in the eigenbasis belong to this part."""
        return {"full": slice(0, 6), "deviatoric": slice(1, 6), "volumetric": slice(0, 1)}[self.part]


def domain_gradient(domains: Domains, field: Array) -> Matrix3:
    """Mean gradient of a nodal field (n, 3) over each domain, as components (D,).

    From differences to the first node: rigid motion cancels before it is multiplied, and float32 depends on that.
    """
    corners = field[domains.cells]
    differences = corners - corners[:, :1]
    exact = jax.lax.Precision.HIGHEST  # accelerators otherwise multiply with fewer digits
    return matrix_of(jnp.einsum("dai,ajd->ijd", differences, domains.gradients, precision=exact))


def domain_strain(
    domains: Domains, positions: Array, kind: RotationKind = "polar"
) -> tuple[list[Array], Matrix3, Matrix3]:
    """Coefficients of the part's strain, rotation and deformation gradient of each domain, as components (D,)."""
    deformation = domain_gradient(domains, positions)
    rotation = rotation_of(deformation, kind)
    return rotated_strain(deformation, rotation)[domains.rows], rotation, deformation


def domain_force(domains: Domains, rotation: Matrix3, stress: Sequence[Array], nodes: int) -> Array:
    """Nodal sums (nodes, 3) of R S grad N_a, S the symmetric matrix of the part's coefficients `stress`, each (D,)."""
    zero = jnp.zeros_like(stress[0])
    coefficients = [zero] * domains.rows.start + list(stress) + [zero] * (6 - domains.rows.stop)
    turned = array_of(product(rotation, from_eigenbasis(coefficients)))
    g = domains.gradients
    others = sum((turned[None, :, j] * g[1:, None, j] for j in (1, 2)), start=turned[None, :, 0] * g[1:, None, 0])
    # The first node takes the reaction, so that forces sum to zero to the last digit.
    forces = jnp.concatenate([-jnp.sum(others, axis=0, keepdims=True), others]).transpose(2, 0, 1)
    return jnp.zeros((nodes, 3), forces.dtype).at[domains.cells].add(forces)


def domain_stiffness(domains: Domains, young: Array, poisson: Array) -> tuple[Array, Array]:
    """Volumetric and deviatoric stiffness (3K, 2 mu) of each domain, () or (D,) [Pa]: means over its elements."""
    volumetric, deviatoric = eigenstiffness(young, poisson)
    return domain_mean(domains, volumetric), domain_mean(domains, deviatoric)


def domain_damping(domains: Domains, young: Array, poisson: Array, damping: Array) -> Array:
    """Damping time beta of each domain, () or (D,) [s]: mean over its elements, weighted by the part's stiffness."""
    if domains.members is None or jnp.ndim(damping) == 0:
        return damping
    weight = eigenstiffness(young, poisson)[0 if domains.part == "volumetric" else 1]
    return domain_mean(domains, weight * damping) / domain_mean(domains, weight)


def domain_mean(domains: Domains, value: Array) -> Array:
    """Mean of an elementwise value () or (E,) over each domain."""
    if domains.members is None or domains.shares is None or jnp.ndim(value) == 0:
        return value
    return jnp.sum(value[domains.members] * domains.shares, axis=1)
