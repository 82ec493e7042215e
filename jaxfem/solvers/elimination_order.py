"""In which order a sparse matrix of small blocks is eliminated, found once on the host; `elimination.py` does it.

Two parts. *Leaves*: nodes whose neighbours are all neighbours of each other, many of them at once, round by round; that
fills nothing in, and takes chains and trees of joints away whole (Rose 1970: perfect elimination). *Core*: what
remains, in an order of small bandwidth (Cuthill & McKee 1969) and cut into dense blocks as wide as that, so that only
neighbouring blocks couple: a block tridiagonal matrix.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from jaxfem.pytrees import Pytree

WIDTHS = (1, 4, 8)
"""Leaves with so many neighbours at most are eliminated together: one loop a class, padded to its number."""
LEAST_ROUND = 16
"""Rounds with fewer leaves are left to the core: a dense block takes them faster."""

LEAST_BLOCK = 16
"""Nodes in a dense block at least, where there are so many: smaller ones would take more steps."""


class Leaves(Pytree):
    """Rounds of leaves, R with up to m each, padded: indices of blocks in a table.

    `nodes` (R, m) and `others` (R, m, w): leaves and their neighbours, N on padding; `beside` (R, m, w): blocks of a
    neighbour's row and the leaf's column; `targets` (R, m, w (w + 1) / 2): blocks that change, of neighbours a <= b.
    """

    nodes: np.ndarray
    others: np.ndarray
    beside: np.ndarray
    targets: np.ndarray


class Core(Pytree):
    """K dense blocks of k nodes. `nodes` (K, k), N on padding; `diagonal` (K, k, k) and `below` (K, k, k): their blocks
    in the table, rows first; only the lower half of the diagonal ones is filled. `below` couples with the next block.
    """

    nodes: np.ndarray
    diagonal: np.ndarray
    below: np.ndarray


class EliminationOrder(Pytree):
    """How to eliminate N nodes with P coupled pairs.

    `pairs` (P, 2): the later node, the earlier. Blocks are numbered: N diagonal ones, P of the pairs (rows of the later
    node), then N + P: zeros, N + P + 1: the identity. The core is None where nothing remains.
    """

    pairs: np.ndarray
    leaves: tuple[Leaves, ...]
    core: Core | None


def elimination_order(count: int, pairs: np.ndarray) -> EliminationOrder:
    """An order for `count` nodes, of which `pairs` (P, 2), each once, are coupled."""
    neighbours: list[set[int]] = [set() for _ in range(count)]
    for i, j in pairs.tolist():
        neighbours[i].add(j)
        neighbours[j].add(i)
    classes, remaining = [], set(range(count))
    for width in WIDTHS:
        rounds = _leaf_rounds(neighbours, remaining, width)
        if rounds:
            classes.append((width, rounds))
    core = _by_bandwidth(sorted(remaining), neighbours)
    sequence = [node for _, rounds in classes for nodes in rounds for node, _ in nodes] + core
    place = np.empty(count, int)
    place[sequence] = np.arange(count)
    oriented = np.array([(i, j) if place[i] > place[j] else (j, i) for i, j in pairs.tolist()], int).reshape(-1, 2)
    blocks = {(i, j): count + number for number, (i, j) in enumerate(oriented.tolist())}
    blocks |= {(i, i): i for i in range(count)}
    zero = count + len(oriented)
    leaves = tuple(_leaves(rounds, place, blocks, count, zero, width) for width, rounds in classes)
    return EliminationOrder(oriented, leaves, _core(core, neighbours, blocks, count, zero) if core else None)


def core_size(order: EliminationOrder) -> tuple[int, int]:
    """Number of the core's dense blocks and nodes in each; zeros without a core."""
    return (0, 0) if order.core is None else order.core.nodes.shape


def _leaf_rounds(neighbours: list[set[int]], remaining: set[int], width: int) -> list[list[tuple[int, list[int]]]]:
    """Rounds of leaves with their neighbours then; takes them out of both arguments."""
    rounds: list[list[tuple[int, list[int]]]] = []
    candidates = set(remaining)
    while True:
        chosen: list[int] = []
        blocked: set[int] = set()
        for node in sorted(candidates):
            if node not in blocked and _is_leaf(neighbours, node, width):
                chosen.append(node)
                blocked |= neighbours[node]
        if len(chosen) < LEAST_ROUND:
            return rounds
        rounds.append([(node, sorted(neighbours[node])) for node in chosen])
        candidates = set(blocked) - set(chosen)
        for node in chosen:
            for other in neighbours[node]:
                neighbours[other].discard(node)
        remaining -= set(chosen)
        # Those that were blocked, and all whose number of neighbours has changed.
        candidates |= {other for node in candidates for other in neighbours[node]}


def _is_leaf(neighbours: list[set[int]], node: int, width: int) -> bool:
    own = neighbours[node]
    return len(own) <= width and all(len(own - neighbours[other]) == 1 for other in own)


def _by_bandwidth(nodes: list[int], neighbours: list[set[int]]) -> list[int]:
    """Nodes in an order of small bandwidth."""
    if not nodes:
        return []
    from scipy.sparse import csr_matrix  # slow to import: only where an order is looked for
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    rows, columns = _links(nodes, neighbours)
    graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(nodes), len(nodes)))
    return [nodes[i] for i in reverse_cuthill_mckee(graph, symmetric_mode=True)]


def _links(nodes: list[int], neighbours: list[set[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Coupled places in a list of nodes, both ways."""
    spot = {node: i for i, node in enumerate(nodes)}
    links = np.array([(spot[i], spot[j]) for i in nodes for j in neighbours[i]], int).reshape(-1, 2)
    return links[:, 0], links[:, 1]


def _leaves(
    rounds: Sequence[Sequence[tuple[int, list[int]]]],
    place: np.ndarray,
    blocks: Mapping[tuple[int, int], int],
    count: int,
    zero: int,
    width: int,
) -> Leaves:
    widest = max(max((len(own) for _, own in nodes), default=0) for nodes in rounds)
    shape = len(rounds), max(len(nodes) for nodes in rounds)
    nodes_at = np.full(shape, count)
    others = np.full((*shape, widest), count)
    beside = np.full((*shape, widest), zero)
    targets = np.full((*shape, widest * (widest + 1) // 2), zero)
    for r, nodes in enumerate(rounds):
        for m, (node, own) in enumerate(nodes):
            later = sorted(own, key=lambda other: -place[other])
            nodes_at[r, m] = node
            others[r, m, : len(later)] = later
            beside[r, m, : len(later)] = [blocks[other, node] for other in later]
            for number, (a, b) in enumerate(upper_pairs(widest)):
                if b < len(later):
                    targets[r, m, number] = blocks[later[a], later[b]]
    return Leaves(nodes_at, others, beside, targets)


def upper_pairs(width: int) -> list[tuple[int, int]]:
    """(a, b) with a <= b < width."""
    return [(a, b) for a in range(width) for b in range(a, width)]


def _core(
    core: list[int], neighbours: list[set[int]], blocks: Mapping[tuple[int, int], int], count: int, zero: int
) -> Core:
    rows, columns = _links(core, neighbours)
    size = max(LEAST_BLOCK, int(np.abs(rows - columns).max(initial=0)))
    number = -(-len(core) // size)
    size = min(size, len(core))
    nodes = np.full((number, size), count)
    nodes.ravel()[: len(core)] = core
    diagonal = np.full((number, size, size), zero)
    below = np.full((number, size, size), zero)
    for at in range(number * size):
        diagonal[at // size, at % size, at % size] = core[at] if at < len(core) else zero + 1
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        if i > j:
            where = diagonal if i // size == j // size else below
            where[j // size, i % size, j % size] = blocks[core[i], core[j]]
    return Core(nodes, diagonal, below)
