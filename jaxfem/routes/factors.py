"""Terms of the condensed matrix that stay factors: volumetric domains reach too far to be assembled cheaply."""

import jax
import jax.numpy as jnp

from jaxfem.model import Pattern
from jaxfem.pytrees import pytree

Array = jax.Array


@pytree
class Factor:
    """B' W B, with B v the divergence of v over each domain, sum_a r_a . v_a; in solver order.

    `rows` (D, 3 m): r_a of each domain, beside their nodes `spots` (D, m); `columns` (N, k, 3): the same node by node,
    beside the domains they belong to, `owners` (N, k); `weight` (D,). `spin` (D, 3, 3) or None: with it the
    sum over b of r_a x spin (r_b x v_b) is added.
    """

    rows: Array
    spots: Array
    columns: Array
    owners: Array
    weight: Array
    spin: Array | None = None

    def divergence(self, vector: Array) -> Array:
        """B v: (N, 3) -> (D,)."""
        count, width = self.rows.shape
        return jnp.einsum("dk,dk->d", self.rows, vector[self.spots].reshape(count, width))

    def gradient(self, scalars: Array) -> Array:
        """B' s: (D,) -> (N, 3)."""
        return jnp.einsum("nki,nk->ni", self.columns, scalars[self.owners])

    def apply(self, vector: Array) -> Array:
        """The term times (N, 3)."""
        product = self.gradient(self.weight * self.divergence(vector))
        return product if self.spin is None else product + self._turned(vector)

    def _turned(self, vector: Array) -> Array:
        arms = self.rows.reshape(*self.spots.shape, 3)
        curl = jnp.sum(jnp.cross(arms, vector[self.spots]), axis=1)
        torque = jnp.einsum("dij,dj->di", self.spin, curl)
        return jnp.sum(jnp.cross(self.columns, torque[self.owners]), axis=1)

    @property
    def diagonal_blocks(self) -> Array:
        """(N, 3, 3), without the spin."""
        return jnp.einsum("nki,nkj,nk->nij", self.columns, self.columns, self.weight[self.owners])

    def galerkin(self, modes: Array) -> Array:
        """Z' (B' W B) Z, (6 G, 6 G), for the modes (G, 3 size, 6) of node groups."""
        groups, size = modes.shape[0], modes.shape[1] // 3
        at = modes.reshape(groups * size, 3, 6)
        arms = self.rows.reshape(*self.spots.shape, 3)
        parts = jnp.einsum("dai,dail->dal", arms, at[self.spots])
        domain = jnp.arange(self.spots.shape[0])[:, None]
        spread = jnp.zeros((self.spots.shape[0], groups, 6), parts.dtype).at[domain, self.spots // size].add(parts)
        flat = spread.reshape(self.spots.shape[0], 6 * groups)
        return flat.T @ (self.weight[:, None] * flat)


def domain_factor(
    turned: Array, weight: Array, free: Array, pattern: Pattern, number: int, spin: Array | None = None
) -> Factor:
    """Factor of volumetric domains, r_a `turned` (m, 3, D), `weight` (D,); nodes with `free` (n,) 0 drop out."""
    spots, incidences = pattern.spots[number], pattern.incidences[number]
    moving = pattern.gathered(free)[spots]
    arms = turned.transpose(2, 0, 1) * moving[:, :, None]
    count, width = spots.shape
    columns = jnp.concatenate([arms.reshape(-1, 3), jnp.zeros((1, 3), arms.dtype)])[incidences]
    owners = jnp.minimum(incidences // width, count - 1)
    turning = None if spin is None else jnp.moveaxis(spin, -1, 0)
    return Factor(arms.reshape(count, 3 * width), spots, columns, owners, weight, turning)
