"""Smoothing domains: the pieces of a body on which one strain is taken. An element is the plainest of them.

The mean deformation gradient over the elements around a node or an edge, weighted by their shares of volume, has one
rotation and one strain; so a domain is a tetrahedron with more corners, and every kernel that serves one serves both.
Smoothing over nodes: Bonet & Burton 1998; over edges, and both at once: Nguyen-Thoi, Liu, Lam & Zhang 2009.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxfem.elements.strains import PARTS, Part, rows_of
from jaxfem.elements.tetra import RotationKind, rotated_strain, rotation_of, tetra_gradient
from jaxfem.indexing import gather, scatter_add
from jaxfem.materials.base import Material
from jaxfem.pytrees import Pytree, static
from jaxfem.tensors import Matrix3, array_of, contract, from_eigenbasis, matrix_of, product

Array = jax.Array

# Above this many shear moduli, the bulk modulus acts on clusters of nodes instead of on each node: see `bulk_shares`.
LOCAL_BULK = 8.0


class Clusters(Pytree):
    """Domains taken together, for rows on their mean strain: arrays over D domains, C clusters, Q pairs that touch.

    `owner` (D,): cluster of each domain; `shares` (D,): its share of the cluster's volume; `volumes` (C,) [m^3].
    `slots` (D, m): number of each domain's nodes among the pairs of a cluster and a node of it; Q on padding.
    `slot_cluster` (Q,) and `slot_node` (Q,): those pairs.
    """

    owner: Array
    shares: Array
    volumes: Array
    slots: Array
    slot_cluster: Array
    slot_node: Array

    @property
    def count(self) -> int:
        """Number of clusters."""
        return self.volumes.shape[0]

    def mean(self, values: Array) -> Array:
        """Mean of a domain-wise value (D,) over each cluster, (C,)."""
        return scatter_add(self.shares * values, self.owner, self.count)

    def spread(self, values: Array) -> Array:
        """The transpose of `mean`: (C,) -> (D,)."""
        return self.shares * gather(values, self.owner)


class Domains(Pytree):
    """Domains of one kind, and the part of the strain that is taken on them; arrays over D domains of up to m nodes.

    Domains of more nodes come first. `cells` (D, m), in the solver's order of nodes, padded by repeating the first;
    `gradients` (m, 3, D) [1/m]: of the mean deformation gradient in the nodes' places, 0 on padding; `volumes` (D,)
    [m^3]; `body` (D,). `members` (D, k) and `shares` (D, k): elements averaged over and their shares of the volume;
    None where domain d is element d. `law`: of their material. `clusters`: with them the rows are on the clusters' mean
    strains.
    """

    cells: Array
    gradients: Array
    volumes: Array
    body: Array
    members: Array | None
    shares: Array | None
    part: Part = static()
    law: Material = static()
    clusters: Clusters | None = None

    @property
    def count(self) -> int:
        """Number of domains."""
        return self.cells.shape[0]

    @property
    def by_element(self) -> bool:
        """Whether all of the strain is taken, on elements."""
        return self.whole and self.members is None

    @property
    def whole(self) -> bool:
        """Whether all of the strain is taken."""
        return self.rows == slice(0, 6)

    @property
    def rows(self) -> slice:
        """Which of the six coefficients in the eigenbasis belong to this part."""
        return rows_of(self.part)

    @property
    def volumetric(self) -> bool:
        """Whether only the volumetric strain is taken."""
        return self.rows == slice(0, 1)

    @property
    def row_volumes(self) -> Array:
        """Volume that each set of rows stands for: (D,), or (C,) with clusters [m^3]."""
        return self.volumes if self.clusters is None else self.clusters.volumes

    @property
    def row_nodes(self) -> Array:
        """A node of the body that each set of rows belongs to: (D,), or (C,) with clusters."""
        if self.clusters is None:
            return self.cells[:, 0]
        return jnp.zeros(self.clusters.count, jnp.int32).at[self.clusters.slot_cluster].set(self.clusters.slot_node)


def domain_gradient(domains: Domains, field: Array) -> Matrix3:
    """Mean gradient of a nodal field (n, 3) over each domain, as components (D,).

    From differences to the first node: rigid motion cancels before it is multiplied, and float32 depends on that.
    """
    if domains.cells.shape[1] == 4:
        return tetra_gradient(domains.cells, domains.gradients, field)
    corners = gather(field, domains.cells)
    differences = corners - corners[:, :1]
    return matrix_of(contract("dai,ajd->ijd", differences, domains.gradients))


def domain_strain(
    domains: Domains, positions: Array, kind: RotationKind = "polar", dropped: Array | None = None
) -> tuple[list[Array], Matrix3, Matrix3]:
    """Coefficients of the part's strain, (D,) or (C,), with rotation and deformation gradient of each domain, (D,).

    `dropped` (n, 3) [m]: digits that rounding has dropped of the positions.
    """
    deformation = domain_gradient(domains, positions)
    if dropped is not None:
        more = domain_gradient(domains, dropped)
        deformation = [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(deformation, more, strict=True)]
    rotation = rotation_of(deformation, kind)
    return row_means(domains, rotated_strain(deformation, rotation)[domains.rows]), rotation, deformation


def domain_strains(
    kinds: Sequence[Domains], positions: Array, kind: RotationKind = "polar", dropped: Array | None = None
) -> list[tuple[list[Array], Matrix3, Matrix3]]:
    """`domain_strain` of each kind of domains; clusters follow the domains that they are made of, and use theirs."""
    found: list[tuple[list[Array], Matrix3, Matrix3]] = []
    for each in kinds:
        if each.clusters is None:
            found.append(domain_strain(each, positions, kind, dropped))
        else:
            strain, rotation, deformation = found[-1]
            found.append((row_means(each, strain), rotation, deformation))
    return found


def turned_ahead(
    kinds: Sequence[Domains], strains: Sequence[tuple[list[Array], Matrix3, Matrix3]], turns: Array
) -> list[tuple[list[Array], Matrix3, Matrix3]]:
    """`domain_strains` with the rotations of each body's domains turned on by its own of `turns` (bodies, 3, 3)."""
    found: list[tuple[list[Array], Matrix3, Matrix3]] = []
    for each, (_, rotation, deformation) in zip(kinds, strains, strict=True):
        if each.clusters is None:
            rotation = product(matrix_of(jnp.moveaxis(turns[each.body], 0, -1)), rotation)
            strain = row_means(each, rotated_strain(deformation, rotation)[each.rows])
        else:
            every, rotation, _ = found[-1]
            strain = row_means(each, every)
        found.append((strain, rotation, deformation))
    return found


def row_means(domains: Domains, coefficients: Sequence[Array]) -> list[Array]:
    """Coefficients of the domains (D,) as those of the rows: means over clusters where there are some."""
    return [c if domains.clusters is None else domains.clusters.mean(c) for c in coefficients]


def domain_force(domains: Domains, rotation: Matrix3, stress: Sequence[Array], nodes: int) -> Array:
    """Nodal sums (nodes, 3) of R S grad N_a, S the symmetric matrix of the rows' coefficients `stress`."""
    if domains.clusters is not None:
        stress = [domains.clusters.spread(s) for s in stress]
    zero = jnp.zeros_like(stress[0])
    coefficients = [zero] * domains.rows.start + list(stress) + [zero] * (6 - domains.rows.stop)
    turned = array_of(product(rotation, from_eigenbasis(coefficients)))
    g = domains.gradients
    others = sum((turned[None, :, j] * g[1:, None, j] for j in (1, 2)), start=turned[None, :, 0] * g[1:, None, 0])
    # The first node takes the reaction, so that forces sum to zero to the last digit.
    forces = jnp.concatenate([-jnp.sum(others, axis=0, keepdims=True), others]).transpose(2, 0, 1)
    return scatter_add(forces, domains.cells, nodes)


class DomainMaterial(Pytree):
    """The material of domains of one kind, each () or one number a set of rows, (D,) or (C,).

    Stress D (e + offset + damping de/dt), D of the `volumetric` and the `deviatoric` stiffness (3K, 2 mu) [Pa];
    `damping` beta [s]. Materials with a memory have an `offset` (r, D), else None, and `damping` (r, D) where it
    differs between rows.
    """

    volumetric: Any
    deviatoric: Any
    damping: Any
    offset: Array | None = None
    linear: ClassVar[bool] = True
    """As its law says of itself."""

    def from_rest(self, strain: list[Array]) -> list[Array]:
        """The strain with the known offset, where there is one."""
        return strain if self.offset is None else [s + o for s, o in zip(strain, self.offset, strict=True)]

    def weights(self, domains: Domains) -> list[Any]:
        """Stiffness of each of the rows."""
        return [self.volumetric, *[self.deviatoric] * 5][domains.rows]


def domain_material(domains: Domains, values: Mapping[str, Array]) -> DomainMaterial:
    """Material of each set of rows, from the `values` of its constants, () or (E,)."""
    return DomainMaterial(*domain_stiffness(domains, values), domain_damping(domains, values))


def domain_stiffness(domains: Domains, values: Mapping[str, Array]) -> tuple[Array, Array]:
    """Volumetric and deviatoric stiffness (3K, 2 mu) of each set of rows, () or (D,) or (C,) [Pa]."""
    volumetric, deviatoric = domains.law.stiffness(values)
    local, shared = bulk_shares(volumetric, deviatoric)
    volumetric = {"all": volumetric, "local": local, "shared": shared}[PARTS[domains.part].bulk]
    return domain_mean(domains, volumetric), domain_mean(domains, deviatoric)


def bulk_shares(volumetric: Array, deviatoric: Array) -> tuple[Array, Array]:
    """The parts of 3K that act on each node and on clusters of nodes; they add up to it.

    With q = K / (8 mu) the local part is 3K / sqrt(1 + q^2): nearly all of it up to nu = 0.4, and never more than 24
    mu. One stiff constraint a node is more than linear displacements can follow (they lock), and what makes the matrix
    ill-conditioned; one a cluster of about eight is not. Cf. the pressure projection of Dohrmann & Bochev 2004.
    """
    ratio = 2 * volumetric / (3 * deviatoric * LOCAL_BULK)
    root = jnp.sqrt(1 + ratio**2)
    return volumetric / root, volumetric * ratio**2 / (root * (root + 1))


def domain_damping(domains: Domains, values: Mapping[str, Array]) -> Any:
    """Damping time beta of each set of rows, () or (D,) or (C,) [s]: mean weighted by the part's stiffness."""
    damping = domains.law.damping(values)
    if domains.members is None or jnp.ndim(damping) == 0:
        return damping
    weight = domains.law.stiffness(values)[0 if domains.volumetric else 1]
    return domain_mean(domains, weight * damping) / domain_mean(domains, weight)


def domain_mean(domains: Domains, value: Array) -> Array:
    """Mean of an elementwise value () or (E,) over what each set of rows stands for: () or (D,) or (C,)."""
    if domains.members is None or domains.shares is None or jnp.ndim(value) == 0:
        return value
    mean = jnp.sum(gather(value, domains.members) * domains.shares, axis=1)
    return mean if domains.clusters is None else domains.clusters.mean(mean)
