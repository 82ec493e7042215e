"""Which elements form a group, which nodes a group has, and which of them it shares with others; host side."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.mesh.partition import partition, separate
from jaxfem.methods.base import CannotServe
from jaxfem.model import Model
from jaxfem.pytrees import Pytree, on_device

Array = jax.Array


class Groups(Pytree):
    """G groups, each with copies of N nodes of its own (padded), S of which other groups have copies of (padded).

    `nodes` (G, N): of the scene, the first again on padding; `slots` (E, 4): where the copies of an element's corners
    stand among the G N; `element` (E,): group of each element. `shared` (G, S): which of a group's copies others have
    too; `real` (G, S) false on padding; `owner` (G, S): number of the node among the H that are shared, H on padding;
    `met` (H,): those nodes of the scene; `copies` (H,): how many copies each has; `side` (H,): where it lies among the
    Q sets of groups that meet anywhere, `sides` (Q, G) 1 for the groups of a set.
    `inner` (G, I): which of a group's copies are its own alone; `within` (G, I) false on padding; `place` (n,): where a
    node stands among the G I inner ones and the H shared, G I + H where it does not move. Only nodes that move are
    inner or shared. `free` (G, N): which copies move, false on padding.
    """

    nodes: Array
    slots: Array
    element: Array
    shared: Array
    real: Array
    owner: Array
    met: Array
    copies: Array
    side: Array
    sides: Array
    inner: Array
    within: Array
    place: Array
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
    cells = np.asarray(model.elements.cells)
    places = np.asarray(model.rest, float)[cells].mean(1)
    body, label, first = np.asarray(model.elements.body), np.zeros(len(places), np.int64), 0
    for number, name in enumerate(model.bodies):
        own = np.flatnonzero(body == number)
        parts = separate(cells[own])
        count = (groups or 0) if size is None else sum(-(-len(part) // size) for part in parts)
        try:
            label[own] = first + partition(places[own], cells[own], count)
        except ValueError as problem:
            raise CannotServe(f'is to cut "{name}" into {count} groups, but {problem}') from None
        first += count
    return label


def group_plan(model: Model, label: np.ndarray) -> Groups:
    """The groups of elements with `label` (E,)."""
    cells, free = np.asarray(model.elements.cells, np.int64), np.asarray(model.free) > 0
    count, points = int(label.max()) + 1, model.nodes
    pairs = np.unique(np.repeat(label, 4) * points + cells.ravel())
    group, node = pairs // points, pairs % points
    nodes, real = _padded(group, node, count)
    rank = np.arange(len(pairs)) - np.searchsorted(group, np.arange(count))[group]
    nodes = np.where(real, nodes, nodes[:, :1])
    moves = real & free[nodes]
    slot = np.searchsorted(pairs, label[:, None] * points + cells)
    copies = np.bincount(node, minlength=points)
    met = np.flatnonzero((copies > 1) & free)
    meets = np.isin(node, met)
    shared, is_shared = _padded(group[meets], rank[meets], count)
    meeting = np.zeros((len(met), count), bool)
    meeting[np.searchsorted(met, node[meets]), group[meets]] = True
    sides, side = np.unique(meeting, axis=0, return_inverse=True) if len(met) else (meeting, met)
    owner = np.searchsorted(met, np.take_along_axis(nodes, shared, 1))
    alone = ~meets & free[node]
    inner, within = _padded(group[alone], rank[alone], count)
    place = np.full(points, inner.size + len(met))
    place[np.take_along_axis(nodes, inner, 1)[within]] = np.flatnonzero(within)
    place[met] = inner.size + np.arange(len(met))
    return Groups(
        nodes=on_device(nodes, jnp.int32),
        slots=on_device((group * nodes.shape[1] + rank)[slot], jnp.int32),
        element=on_device(label, jnp.int32),
        shared=on_device(shared, jnp.int32),
        real=jnp.asarray(is_shared),
        owner=on_device(np.where(is_shared, owner, len(met)), jnp.int32),
        met=on_device(met, jnp.int32),
        copies=on_device(copies[met], jnp.int32),
        side=on_device(np.ravel(side), jnp.int32),
        sides=on_device(sides, model.rest.dtype),
        inner=on_device(inner, jnp.int32),
        within=jnp.asarray(within),
        place=on_device(place, jnp.int32),
        free=jnp.asarray(moves),
    )


def _padded(group: np.ndarray, values: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Values (k,) of groups (k,), in order, as (count, most), zero on padding, and which of these are real."""
    rank = np.arange(len(group)) - np.searchsorted(group, np.arange(count))[group] if len(group) else group
    shape = count, int(rank.max(initial=-1)) + 1
    table, real = np.zeros(shape, np.int64), np.zeros(shape, bool)
    table[group, rank], real[group, rank] = values, True
    return table, real
