"""What elements and strain domains hold of the undeformed shape, made anew for other rest positions; differentiable.

`build` makes the same on the host, in float64, with topology and all (`tetra.shape_gradients`, `smoothing.py`); here
the topology is kept, and only numbers follow.
"""

from collections.abc import Sequence
from typing import Any, Self

import jax
import jax.numpy as jnp

from jaxfem.elements.domains import Clusters, Domains
from jaxfem.elements.tetra import Elements
from jaxfem.pytrees import Pytree

Array = jax.Array


class Shaped(Pytree):
    """Base of what has rest positions, `rest`, and `elements` and more that come of them."""

    def replace(self, **changes: Any) -> Self:
        """The same with some fields changed. ValueError for `rest` alone, of which nothing else would follow."""
        if "rest" in changes and "elements" not in changes:
            raise ValueError(
                "replace(rest=...) would change no volume, mass or strain, and have derivatives of zero: use "
                "jaxfem.rebuild(model, rest), which makes all that comes of the rest shape"
            )
        return super().replace(**changes)


def reshaped_elements(elements: Elements, rest: Array) -> Elements:
    """The same tetrahedra with nodes at `rest` (n, 3) [m]: gradients and volumes.

    Rows of the inverse of the edges are the cross products of two of them over six volumes.
    """
    corners = rest[elements.cells]
    a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
    across = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    six = jnp.sum(a * across[0], -1)
    inverse = across / six[None, :, None]
    gradients = jnp.concatenate([-inverse.sum(0, keepdims=True), inverse])
    return elements.replace(gradients=gradients.transpose(0, 2, 1), volumes=six / 6)


def reshaped_nodal_volumes(elements: Elements, nodes: int) -> Array:
    """A quarter of each element's volume at each of its corners, (nodes,) [m^3]."""
    quarter = jnp.broadcast_to(elements.volumes[:, None] / 4, elements.cells.shape)
    return jnp.zeros(nodes, quarter.dtype).at[elements.cells].add(quarter)


def reshaped_domains(kinds: Sequence[Domains], before: Elements, after: Elements) -> tuple[Domains, ...]:
    """Each kind of domains as the reshaped elements `after` make them; `before`: those it was built with."""
    return tuple(_reshaped(each, before, after) for each in kinds)


def _reshaped(domains: Domains, before: Elements, after: Elements) -> Domains:
    members, shares = domains.members, domains.shares
    if members is None or shares is None:
        members = jnp.arange(domains.count)[:, None]
        shares = jnp.ones(members.shape, after.volumes.dtype)
    real = shares > 0  # padding repeats the first member without a share
    # An element gives an equal piece of its volume to each of its nodes or edges: how many they are the volumes tell.
    pieces = jnp.round(jnp.sum(jnp.where(real, before.volumes[members], 0), 1) / domains.volumes)
    own = jnp.where(real, after.volumes[members], 0) / jax.lax.stop_gradient(pieces)[:, None]
    volumes = jnp.sum(own, 1)
    weights = own / volumes[:, None]
    return domains.replace(
        gradients=_mean_gradients(domains, after, members, weights),
        volumes=volumes,
        shares=None if domains.shares is None else weights,
        clusters=None if domains.clusters is None else _reshaped_clusters(domains.clusters, volumes),
    )


def _mean_gradients(domains: Domains, elements: Elements, members: Array, weights: Array) -> Array:
    """Sums of the members' shape gradients (m, 3, D) in the domains' own nodes, one member of each at a time."""
    start = jnp.zeros((*domains.cells.shape, 3), weights.dtype)
    rows = jnp.arange(domains.count)[:, None]

    def add(total: Array, given: tuple[Array, Array]) -> tuple[Array, None]:
        member, weight = given
        corners = elements.cells[member]
        slots = jnp.argmax(domains.cells[:, None, :] == corners[:, :, None], axis=2)  # padding comes behind its like
        gradients = elements.gradients[:, :, member].transpose(2, 0, 1)
        return total.at[rows, slots].add(weight[:, None, None] * gradients), None

    total, _ = jax.lax.scan(add, start, (members.T, weights.T))
    return total.transpose(1, 2, 0)


def _reshaped_clusters(clusters: Clusters, volumes: Array) -> Clusters:
    total = jnp.zeros(clusters.count, volumes.dtype).at[clusters.owner].add(volumes)
    return clusters.replace(shares=volumes / total[clusters.owner], volumes=total)
