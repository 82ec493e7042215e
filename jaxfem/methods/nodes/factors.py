"""Terms of the condensed matrix that stay factors: volumetric domains reach too far to be assembled cheaply."""

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import Clusters, Domains
from jaxfem.elements.pattern import Pattern
from jaxfem.indexing import gather
from jaxfem.pytrees import Pytree
from jaxfem.rows.elastic import cluster_arms
from jaxfem.tensors import contract, matmul, taken

Array = jax.Array


class ClusterTerm(Pytree):
    """B' P' W P B, with P the mean over clusters: few rows, but stiff ones where a material hardly changes its volume.

    `weight` (C,); `arms` (Q + 1, 3): P B by pairs of a cluster and a node; `touching` (N, k): the pairs of each node.
    """

    clusters: Clusters
    weight: Array
    arms: Array
    touching: Array

    def schur(self, inverse_blocks: Array) -> Array:
        """P B D^-1 B' P', (C, C), for a block diagonal D with inverse blocks (N, 3, 3)."""
        at = self.arms[self.touching]
        products = contract("nki,nij,nlj->nkl", at, inverse_blocks, at)
        owner = jnp.append(self.clusters.slot_cluster, 0)[self.touching]
        count = self.clusters.count
        return jnp.zeros((count, count), at.dtype).at[owner[:, :, None], owner[:, None]].add(products)


class Bend(Pytree):
    """G' M G, with G v the gradient of v over each domain: `rows` (D, 3 m) and `columns` (N, k, 3) as in `Factor`, with
    grad N_a for r_a; `matrix` (D, 9, 9). It may be indefinite."""

    rows: Array
    columns: Array
    matrix: Array

    def apply(self, vector: Array, spots: Array, owners: Array) -> Array:
        """The term times (N, 3)."""
        slopes = self.rows.reshape(*spots.shape, 3)
        gradient = contract("dmi,dmj->dij", vector[spots], slopes)
        stress = contract("dab,db->da", self.matrix, gradient.reshape(-1, 9)).reshape(-1, 3, 3)
        return contract("nkj,nkij->ni", self.columns, stress[owners])


class Factor(Pytree):
    """B' W B, with B v the divergence of v over each domain, sum_a r_a . v_a; in solver order.

    `rows` (D, 3 m): r_a of each domain, beside their nodes `spots` (D, m); `columns` (N, k, 3): the same node by node,
    beside the domains they belong to, `owners` (N, k); `weight` (D,). `spin` (D, 3, 3) or None: with it the sum over b
    of r_a x spin (r_b x v_b) is added. `shared`: a further term, on the means over clusters. `bend`: one on gradients.
    """

    rows: Array
    spots: Array
    columns: Array
    owners: Array
    weight: Array
    spin: Array | None = None
    shared: ClusterTerm | None = None
    bend: Bend | None = None

    def divergence(self, vector: Array) -> Array:
        """B v: (N, 3) -> (D,)."""
        return contract("dk,dk->d", self.rows, taken(vector, self.spots))

    def gradient(self, scalars: Array) -> Array:
        """B' s: (D,) -> (N, 3)."""
        return contract("nki,nk->ni", self.columns, gather(scalars, self.owners))

    def apply(self, vector: Array) -> Array:
        """The term times (N, 3)."""
        change = self.divergence(vector)
        stress = self.weight * change
        if self.shared is not None:
            clusters = self.shared.clusters
            stress = stress + clusters.spread(self.shared.weight * clusters.mean(change))
        product = self.gradient(stress)
        if self.bend is not None:
            product = product + self.bend.apply(vector, self.spots, self.owners)
        return product if self.spin is None else product + self._turned(self.spin, vector)

    def _turned(self, spin: Array, vector: Array) -> Array:
        arms = self.rows.reshape(*self.spots.shape, 3)
        curl = jnp.sum(jnp.cross(arms, vector[self.spots]), axis=1)
        torque = contract("dij,dj->di", spin, curl)
        return jnp.sum(jnp.cross(self.columns, torque[self.owners]), axis=1)

    @property
    def diagonal_blocks(self) -> Array:
        """(N, 3, 3), without the spin, the bend and clusters."""
        return contract("nki,nkj,nk->nij", self.columns, self.columns, gather(self.weight, self.owners))

    def galerkin(self, modes: Array) -> Array:
        """Z' (B' W B) Z, (6 G, 6 G), for the modes (G, 3 size, 6) of node groups; without spin, bend and clusters."""
        flat = self.on_modes(modes)
        return matmul(flat.T, self.weight[:, None] * flat)

    def on_modes(self, modes: Array) -> Array:
        """B Z, (D, 6 G)."""
        groups, size = modes.shape[0], modes.shape[1] // 3
        at = modes.reshape(groups * size, 3, 6)
        arms = self.rows.reshape(*self.spots.shape, 3)
        parts = contract("dai,dail->dal", arms, gather(at, self.spots))
        domain = jnp.arange(self.spots.shape[0])[:, None]
        spread = jnp.zeros((self.spots.shape[0], groups, 6), parts.dtype).at[domain, self.spots // size].add(parts)
        return spread.reshape(self.spots.shape[0], 6 * groups)


def domain_factor(
    turned: Array, weight: Array, free: Array, pattern: Pattern, number: int, spin: Array | None = None
) -> Factor:
    """Factor of volumetric domains, r_a `turned` (m, 3, D), `weight` (D,); nodes with `free` (n,) 0 drop out."""
    spots, incidences = pattern.spots[number], pattern.incidences[number]
    moving = gather(pattern.gathered(free), spots)
    arms = turned.transpose(2, 0, 1) * moving[:, :, None]
    count, width = spots.shape
    columns = gather(jnp.concatenate([arms.reshape(-1, 3), jnp.zeros((1, 3), arms.dtype)]), incidences)
    owners = jnp.minimum(incidences // width, count - 1)
    turning = None if spin is None else jnp.moveaxis(spin, -1, 0)
    return Factor(arms.reshape(count, 3 * width), spots, columns, owners, weight, turning)


def clustered(
    factor: Factor,
    domains: Domains,
    turned: Array,
    weight: Array,
    free: Array,
    pattern: Pattern,
    number: int,
    spin: Array | None = None,
) -> Factor:
    """The factor of local volumetric rows, with the shared ones of the same domains added; `weight` (C,).

    `number`: how many kinds with clusters come before these; there is one for each material law.
    """
    assert domains.clusters is not None
    touching = pattern.touching[number]
    moving = jnp.append(free[domains.clusters.slot_node], 0.0)
    arms = cluster_arms(domains, turned) * moving[:, None]
    if spin is not None and factor.spin is not None:
        factor = factor.replace(spin=factor.spin + jnp.moveaxis(spin, -1, 0))
    term = ClusterTerm(domains.clusters, weight, arms, touching)
    return factor.replace(shared=term)
