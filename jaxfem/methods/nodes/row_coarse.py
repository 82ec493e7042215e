"""Coarse space in which stiff rows take part: rigid modes of node groups, and rigid bodies as they are.

Many rows between bodies tie their rigid motions, far softer than the bodies themselves. A coarse matrix made without
these rows takes such motions for free, and conjugate gradients undo its mistake step by step. This one is made anew
for each active set, Z' (S + J' k J) Z; it is small, so that costs less than the iterations that it saves.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxfem.methods.nodes.preconditioner import inverse_of_coarse
from jaxfem.methods.nodes.row_stiffness import RowStiffness
from jaxfem.pytrees import Pytree, static
from jaxfem.tensors import contract, matmul

Array = jax.Array


class CoarseSpace(Pytree):
    """Z on all triples in solver order: triple t moves with (3, 6) `basis` [t] times the six numbers of `owner` [t].

    `bare` (6 c, 6 c): Z'SZ without rows, of the `count` c owners.
    """

    owner: Array
    basis: Array
    bare: Array
    count: int = static()

    def inverse(self, kinds: Sequence[RowStiffness]) -> Array:
        """(Z' (S + J' k J) Z)^-1."""
        coarse = self.bare.reshape(self.count, 6, self.count, 6).transpose(0, 2, 1, 3)
        for kind in kinds:
            coarse = self._added(coarse, kind)
        return inverse_of_coarse(coarse.transpose(0, 2, 1, 3).reshape(self.bare.shape))

    def correction(self, inverse: Array, residual: Array) -> Array:
        """Z inverse Z' r on fields (N, 3)."""
        own = contract("tij,ti->tj", self.basis, residual)
        restricted = jnp.zeros((self.count, 6), own.dtype).at[self.owner].add(own)
        found = matmul(inverse, restricted.reshape(-1)).reshape(self.count, 6)
        return contract("tij,tj->ti", self.basis, found[self.owner])

    def _added(self, coarse: Array, kind: RowStiffness) -> Array:
        rows = kind.rows
        m, r, _ = rows.jacobian.shape
        owner = self.owner[rows.triples]
        seen = contract("mrki,mkij->mrkj", rows.jacobian.reshape(m, r, -1, 3), self.basis[rows.triples])
        blocks = contract("mrki,mr,mrlj->mklij", seen, kind.stiffness, seen)
        return coarse.at[owner[:, :, None], owner[:, None, :]].add(blocks)


def coarse_space(modes: Array, bare: Array, masses: Array) -> CoarseSpace:
    """From the groups' `modes` (g, 3 size, 6), their `bare` Z'SZ, and the rigid bodies' blocks `masses` (2 b, 3, 3)."""
    groups, bodies = modes.shape[0], masses.shape[0] // 2
    nodes = modes.reshape(-1, 3, 6)
    unit = jnp.eye(6, dtype=modes.dtype).reshape(2, 1, 3, 6)
    rigid = jnp.broadcast_to(unit, (2, bodies, 3, 6)).reshape(-1, 3, 6)
    numbers = groups + jnp.arange(bodies)
    owner = jnp.concatenate([jnp.repeat(jnp.arange(groups), nodes.shape[0] // groups), numbers, numbers])
    count = groups + bodies
    whole = jnp.zeros((count, 6, count, 6), bare.dtype)
    whole = whole.at[:groups, :, :groups].set(bare.reshape(groups, 6, groups, 6))
    linear, angular = masses[:bodies], masses[bodies:]
    whole = whole.at[numbers, :3, numbers, :3].set(linear).at[numbers, 3:, numbers, 3:].set(angular)
    return CoarseSpace(owner, jnp.concatenate([nodes, rigid]), whole.reshape(6 * count, 6 * count), count)
