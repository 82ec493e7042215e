"""Where blocks of the assembled matrix go: solver order, neighbours, pairs of nodes, incidences. Host side, once."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.elements.domains import Domains
from jaxfem.elements.pattern import Pattern
from jaxfem.pytrees import on_device


def solver_order(points: int, groups: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes group by group, padded to equal sizes: `order` (N,), `real` (N,), and each node's `place` (n,)."""
    size = max(len(g) for g in groups)
    padded = len(groups) * size
    order, real = np.zeros(padded, np.int64), np.zeros(padded)
    for number, group in enumerate(groups):
        order[number * size : number * size + len(group)] = group
        real[number * size : number * size + len(group)] = 1
    place = np.zeros(points, np.int64)
    place[order[real > 0]] = np.flatnonzero(real)
    return order, real, place


def sparsity(
    points: np.ndarray,
    domains: Sequence[Domains],
    groups: list[np.ndarray],
    dtype: Any,
    corners: np.ndarray | None = None,
) -> Pattern:
    """The pattern of the matrix that `domains` need; `groups` partition the nodes.

    `corners` (E, 4): of all elements, where their masses are tied together. Padding rows and padding neighbours point
    to the node itself.
    """
    order, real, place = solver_order(len(points), groups)
    cells = [place[np.asarray(each.cells)] for each in domains]
    valid = [_valid(each) for each in cells]
    assembled = [not each.volumetric for each in domains]
    shared = [each.clusters for each in domains if each.clusters is not None]
    nodes = len(order)
    keys, pairs = _pairs([c if use else c[:0] for c, use in zip(cells, assembled, strict=True)], valid, nodes)
    neighbours, blocks = _padded_rows(keys // nodes, keys % nodes, nodes)
    return Pattern(
        on_device(neighbours, jnp.int32),
        on_device(blocks, jnp.int32),
        tuple(tuple(on_device(slots, jnp.int32) for slots in each) for each in pairs),
        tuple(on_device(c[: 0 if use else None], jnp.int32) for c, use in zip(cells, assembled, strict=True)),
        tuple(
            on_device(_incidences(c[: 0 if use else None], v, nodes), jnp.int32)
            for c, v, use in zip(cells, valid, assembled, strict=True)
        ),
        on_device(order, jnp.int32),
        on_device(place, jnp.int32),
        on_device(real, dtype),
        on_device(_frames(points, [d for d, use in zip(domains, assembled, strict=True) if use], groups), jnp.int32),
        tuple(on_device(_occurrences(place[np.asarray(each.slot_node)], nodes), jnp.int32) for each in shared),
        None if corners is None else on_device(_corner_pairs(place[corners], keys, nodes), jnp.int32),
        len(keys),
    )


def _corner_pairs(cells: np.ndarray, keys: np.ndarray, nodes: int) -> np.ndarray:
    """Where the six pairs of each element's corners stand among the sorted keys of all pairs, (6, E)."""
    first, second = np.triu_indices(4, 1)
    a, b = cells[:, first].T.astype(np.int64), cells[:, second].T
    places: np.ndarray = np.searchsorted(keys, np.minimum(a, b) * nodes + np.maximum(a, b))
    return places


def _valid(cells: np.ndarray) -> np.ndarray:
    """Where `cells` (D, m) hold a node and not padding, which repeats the first."""
    real: np.ndarray = cells != cells[:, :1]
    real[:, 0] = True
    return real


def _pairs(cells: list[np.ndarray], valid: list[np.ndarray], nodes: int) -> tuple[np.ndarray, list[list[np.ndarray]]]:
    """Sorted keys (first * nodes + second) of all pairs of nodes that share a domain; where each domain's stand."""
    columns = []
    for each, real in zip(cells, valid, strict=True):
        for b in range(1, each.shape[1] if len(each) else 0):
            count = int(real[:, b].sum())  # domains of more nodes come first
            columns.append((each[:count, :b].astype(np.int64) * nodes + each[:count, b : b + 1]).T)
    keys, where = np.unique(np.concatenate([c.ravel() for c in columns]), return_inverse=True)
    split = iter(np.split(where.ravel(), np.cumsum([c.size for c in columns])[:-1]))
    shapes = iter(columns)
    return keys, [
        [next(split).reshape(next(shapes).shape) for _ in range(1, each.shape[1] if len(each) else 0)] for each in cells
    ]


def _padded_rows(first: np.ndarray, second: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours (nodes, width), the node itself first, and where each block stands in [pairs, transposes, zero]."""
    count = len(first)
    rows, columns = np.concatenate([first, second]), np.concatenate([second, first])
    order = np.lexsort((columns, rows))
    rows, columns = rows[order], columns[order]
    position = np.arange(2 * count) - np.searchsorted(rows, rows) + 1  # slot 0 is the diagonal
    width = int(position.max(initial=0)) + 1
    neighbours = np.tile(np.arange(nodes)[:, None], (1, width))
    blocks = np.full((nodes, width), 2 * count)
    neighbours[rows, position] = columns
    blocks[rows, position] = order
    return neighbours, blocks


def _incidences(cells: np.ndarray, valid: np.ndarray, nodes: int) -> np.ndarray:
    """Where each node occurs in `cells` (D, m), as flat places in padded rows (nodes, k); m D on padding."""
    if not len(cells):
        return np.zeros((nodes, 0), np.int64)
    flat = np.flatnonzero(valid.ravel())
    places = np.append(flat, cells.size)
    incidences: np.ndarray = places[_occurrences(cells.ravel()[flat], nodes)]
    return incidences


def _occurrences(node: np.ndarray, nodes: int) -> np.ndarray:
    """Where each of `nodes` occurs in a list `node` (Q,), in padded rows (nodes, k); Q on padding."""
    order = np.argsort(node, kind="stable")
    ordered = node[order]
    position = np.arange(len(node)) - np.searchsorted(ordered, ordered)
    rows = np.full((nodes, position.max(initial=0) + 1), len(node))
    rows[ordered, position] = order
    return rows


def _frames(points: np.ndarray, domains: Sequence[Domains], groups: list[np.ndarray]) -> np.ndarray:
    """The domain nearest each group's centre among those that touch it, counted through all of them, (groups,)."""
    group_of = np.zeros(len(points), np.int64)
    for number, group in enumerate(groups):
        group_of[group] = number
    middles = np.stack([points[group].mean(0) for group in groups])
    cells = [np.asarray(each.cells) for each in domains]
    owner = np.concatenate([group_of[c].ravel() for c in cells])
    centre = np.concatenate([np.repeat(points[c].mean(1), c.shape[1], axis=0) for c in cells])
    widths = np.concatenate([np.full(*c.shape) for c in cells])
    domain = np.repeat(np.arange(len(widths)), widths)
    distance = np.sum((centre - middles[owner]) ** 2, axis=1)
    nearest = np.lexsort((distance, owner))
    _, first = np.unique(owner[nearest], return_index=True)
    return domain[nearest[first]]
