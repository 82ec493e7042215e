"""Which elements form a group, which nodes a group has, and which of them it shares with others; host side."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.mesh.partition import partition
from jaxfem.methods.base import CannotServe
from jaxfem.model import Model
from jaxfem.pytrees import Pytree, on_device

Array = jax.Array


class Groups(Pytree):
    """G groups, each with copies of N nodes of its own (padded), S of which other groups have copies of (padded).

    `nodes` (G, N): of the scene, the first again on padding; `slots` (E, 4): where the copies of an element's corners
    stand among the G N; `element` (E,): group of each element. `shared` (G, S): which of a group's copies others have
    too; `real` (G, S) false on padding; `owner` (G, S): number of the node among the H that are shared, H on padding;
    `copies` (H,): how many copies it has; `first`, `other` (m,): a node's first copy and each other one, among the G S,
    in pairs. Only nodes that move are shared. `free` (G, N): which copies move, false on
    padding.
    """

    nodes: Array
    slots: Array
    element: Array
    shared: Array
    real: Array
    owner: Array
    copies: Array
    first: Array
    other: Array
    free: Array

    @property
    def count(self) -> int:
        """Number of groups."""
        return self.nodes.shape[0]

    @property
    def tied(self) -> bool:
        """Whether any two groups meet."""
        return self.copies.shape[0] > 0


def element_groups(model: Model, groups: int | None, size: int | None) -> np.ndarray:
    """Group (E,) of each element: `groups` a body, or as many as keep each to `size` elements. CannotServe."""
    places = np.asarray(model.rest, float)[np.asarray(model.elements.cells)].mean(1)
    body, label, first = np.asarray(model.elements.body), np.zeros(len(places), np.int64), 0
    for number, name in enumerate(model.bodies):
        own = np.flatnonzero(body == number)
        count = groups if size is None else -(-len(own) // size)
        if count is None or count > len(own):
            raise CannotServe(f'is to cut "{name}" into {count} groups, but it has {len(own)} elements: ask for fewer')
        label[own] = first + partition(places[own], count)
        first += count
    return label


def group_plan(model: Model, label: np.ndarray) -> Groups:
    """The groups of elements with `label` (E,)."""
    cells, free = np.asarray(model.elements.cells, np.int64), np.asarray(model.free) > 0
    count, points = int(label.max()) + 1, model.nodes
    pairs = np.unique(np.repeat(label, 4) * points + cells.ravel())
    group, node = pairs // points, pairs % points
    rank = np.arange(len(pairs)) - np.searchsorted(group, np.arange(count))[group]
    width = int(rank.max()) + 1
    nodes = np.repeat(node[np.searchsorted(group, np.arange(count))][:, None], width, 1)
    moves = np.zeros((count, width), bool)
    nodes[group, rank], moves[group, rank] = node, free[node]
    place = np.searchsorted(pairs, label[:, None] * points + cells)
    meets = np.flatnonzero((np.bincount(node, minlength=points) > 1) & free)
    chosen = np.isin(node, meets)
    own, its, at = group[chosen], node[chosen], rank[chosen]
    order = np.arange(len(own)) - np.searchsorted(own, np.arange(count))[own] if len(own) else own
    most = int(order.max(initial=-1)) + 1
    shared, real = np.zeros((count, most), np.int64), np.zeros((count, most), bool)
    owner = np.full((count, most), len(meets))
    shared[own, order], real[own, order], owner[own, order] = at, True, np.searchsorted(meets, its)
    number, flat = np.searchsorted(meets, its), own * most + order
    sort = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[sort], np.arange(len(meets)))
    others = np.delete(sort, starts)
    return Groups(
        nodes=on_device(nodes, jnp.int32),
        slots=on_device((group * width + rank)[place], jnp.int32),
        element=on_device(label, jnp.int32),
        shared=on_device(shared, jnp.int32),
        real=jnp.asarray(real),
        owner=on_device(owner, jnp.int32),
        copies=on_device(np.bincount(node, minlength=points)[meets], jnp.int32),
        first=on_device(flat[sort[starts]][number[others]], jnp.int32),
        other=on_device(flat[others], jnp.int32),
        free=jnp.asarray(moves),
    )
