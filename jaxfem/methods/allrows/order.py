"""Rows of a scene as a sparse matrix of small blocks: which rows form a node, which nodes couple, where entries go.

A node holds the rows between the same free bodies, up to six: a hinge's five, a weld's six. Two nodes are coupled when
a free body has rows of both. All of this is topology: found once on the host, from the triples that rows act on.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import Pytree, on_device
from jaxfem.solvers.elimination_order import EliminationOrder, core_size, elimination_order

Node = tuple[frozenset[int], list[tuple[int, int]]]
"""Bodies, and the (kind, block) of its rows."""

MOST_ROWS = 6
MOST_WORK = 2e9
"""Multiplications in the dense core beyond which rows are not eliminated: a tenth of a second and more."""
MOST_PAIRS = 400_000
"""Coupled pairs of nodes beyond which they are not."""


class RowOrder(Pytree):
    """Where the rows of a scene are in N nodes of s rows each, and how A is made of their parts; indices throughout.

    `rows` (N, s): flat number of each row, all kinds one after the other, R on padding; `places` (R,): its flat place
    in (N, s). `triples` (N, t): what a node acts on; `parts` (N, s, t, q): which of all rows' jacobian parts, counted
    flat, make up the entry of a row and a triple, their number on padding. `shared` (P, h, 2): where two coupled nodes
    have the same triple, as flat places in (N, t), N t on padding.
    """

    rows: Any
    places: Any
    triples: Any
    parts: Any
    shared: Any
    elimination: EliminationOrder


def row_order(triples: Sequence[np.ndarray], heights: Sequence[int], body_of: np.ndarray) -> RowOrder | None:
    """The order of rows whose kinds act on `triples` (m, k) with `heights` rows a block; None where that is too dear.

    `body_of` (n,): the body of each triple, -1 for those that do not move.
    """
    nodes, row_starts, part_starts = _nodes(triples, heights, body_of)
    if not nodes:
        return None
    of_body = defaultdict(list)
    for number, (bodies, _) in enumerate(nodes):
        for body in bodies:
            of_body[body].append(number)
    if sum(len(own) ** 2 for own in of_body.values()) > 2 * MOST_PAIRS:
        return None
    coupled = {(i, j) for own in of_body.values() for i in own for j in own if i < j}
    elimination = elimination_order(len(nodes), np.array(sorted(coupled), int).reshape(-1, 2))
    size = max(sum(heights[kind] for kind, _ in blocks) for _, blocks in nodes)
    blocks, width = core_size(elimination)
    if 3 * blocks * (width * size) ** 3 > MOST_WORK:
        return None
    rows, places, acted, parts = _placed(nodes, size, triples, heights, body_of, row_starts, part_starts)
    shared = _shared(elimination.pairs, acted, int(body_of.shape[0]))
    found = RowOrder(rows, places, acted, parts, shared, elimination)
    placed: RowOrder = jax.tree.map(lambda leaf: on_device(leaf, jnp.int32), found)
    return placed


def _nodes(
    triples: Sequence[np.ndarray], heights: Sequence[int], body_of: np.ndarray
) -> tuple[list[Node], np.ndarray, np.ndarray]:
    """Nodes as (bodies, [(kind, block), ...]), and where each kind's rows and parts start."""
    nodes: list[Node] = []
    open_nodes: dict[frozenset[int], tuple[int, int]] = {}
    for kind, own in enumerate(triples):
        for block, bodies in enumerate(body_of[own].tolist() if own.size else [[]] * len(own)):
            key = frozenset(bodies) - {-1}
            number, filled = open_nodes.get(key, (-1, MOST_ROWS))
            if filled + heights[kind] > MOST_ROWS:
                number, filled = len(nodes), 0
                nodes.append((key, []))
            nodes[number][1].append((kind, block))
            open_nodes[key] = number, filled + heights[kind]
    rows = np.cumsum([0] + [len(own) * height for own, height in zip(triples, heights, strict=True)])
    parts = np.cumsum([0] + [own.size * height for own, height in zip(triples, heights, strict=True)])
    return nodes, rows, parts


def _placed(
    nodes: Sequence[Node],
    size: int,
    triples: Sequence[np.ndarray],
    heights: Sequence[int],
    body_of: np.ndarray,
    row_starts: np.ndarray,
    part_starts: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`rows`, `places`, `triples` and `parts` of a RowOrder."""
    own = []
    for _, blocks in nodes:
        acting = {int(t) for kind, block in blocks for t in triples[kind][block]}
        own.append(sorted(t for t in acting if body_of[t] >= 0))
    width = max(1, max(len(each) for each in own))
    count, last, none = len(nodes), int(row_starts[-1]), int(part_starts[-1])
    rows = np.full((count, size), last)
    acted = np.full((count, width), len(body_of))
    lists: dict[tuple[int, int, int], list[int]] = defaultdict(list)
    for number, (_, blocks) in enumerate(nodes):
        acted[number, : len(own[number])] = own[number]
        slot = {t: i for i, t in enumerate(own[number])}
        at = 0
        for kind, block in blocks:
            k = triples[kind].shape[1]
            for r in range(heights[kind]):
                rows[number, at] = row_starts[kind] + block * heights[kind] + r
                first = part_starts[kind] + (block * heights[kind] + r) * k
                for i, t in enumerate(triples[kind][block].tolist()):
                    if t in slot:
                        lists[number, at, slot[t]].append(int(first + i))
                at += 1
    repeats = max((len(each) for each in lists.values()), default=1)
    parts = np.full((count, size, width, repeats), none)
    for (number, at, i), each in lists.items():
        parts[number, at, i, : len(each)] = each
    places = np.empty(last, int)
    places[rows[rows < last]] = np.flatnonzero(rows < last)
    return rows, places, acted, parts


def _shared(pairs: np.ndarray, acted: np.ndarray, unknowns: int) -> np.ndarray:
    count, width = acted.shape
    found = []
    for i, j in pairs.tolist():
        slots = {t: s for s, t in enumerate(acted[j].tolist()) if t < unknowns}
        found.append([(i * width + s, j * width + slots[t]) for s, t in enumerate(acted[i].tolist()) if t in slots])
    shared = np.full((len(pairs), max((len(each) for each in found), default=1), 2), count * width)
    for number, each in enumerate(found):
        shared[number, : len(each)] = each
    return shared
