"""Where a matrix assembled on the nodes has its blocks, and the order of nodes in which it is solved."""

import jax

from jaxfem.indexing import gather
from jaxfem.pytrees import Pytree, static

Array = jax.Array


class Pattern(Pytree):
    """Where the assembled matrix has its 3x3 blocks, on nodes in *solver order*: group by group, padded to equal sizes.

    `neighbours` (N, width): each node's neighbours in padded rows, itself first; `blocks` (N, width): the row of each
    block in a table of the P pairs' blocks, their transposes, and zero. `pairs`, a tuple for each kind of domains: the
    pair of nodes a < b of each domain, (b, D_b) arrays for b = 1, 2, ... over the D_b domains that have a node b; empty
    for volumetric domains, which stay factors: `spots` (D, m) their nodes and `incidences` (N, k) the flat places
    in `spots` where each node occurs, m D on padding; `touching`, a (N, k) for each kind with clusters: the pairs of a
    cluster and a node in which each node occurs, Q on padding.
    `order` (N,): the user's number of each node; `place` (n,): the solver's number; `real` (N,): 0 where a row is
    padding. `frames` (groups,): a domain whose rotation stands for its group's, counted through all that are not
    volumetric. `corner_pairs` (6, E): the pairs of each element's corners, where masses are not lumped.
    `pair_count`: P.
    """

    neighbours: Array
    blocks: Array
    pairs: tuple[tuple[Array, ...], ...]
    spots: tuple[Array, ...]
    incidences: tuple[Array, ...]
    order: Array
    place: Array
    real: Array
    frames: Array
    touching: tuple[Array, ...]
    corner_pairs: Array | None
    pair_count: int = static()

    def gathered(self, field: Array) -> Array:
        """A nodal field (n, ...) in solver order (N, ...); zero on padding."""
        shape = (-1,) + (1,) * (field.ndim - 1)
        return gather(field, self.order) * self.real.reshape(shape)

    def scattered(self, field: Array) -> Array:
        """A field in solver order (N, ...) in the user's order (n, ...)."""
        return gather(field, self.place)
