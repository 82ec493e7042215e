"""Elements in groups of about equal size: recursive bisection of their centroids (Simon 1991).

Parts that do not hang together are kept apart, each with groups of its own, and of two axes to cut across the one is
taken that leaves both halves in one piece: what moves by itself shares no rotation with anything else.
"""

from typing import Any

import numpy as np

from .checks import Ints
from .topology import first_of_each


def partition(places: Any, cells: Any, groups: int) -> Ints:
    """Group (m,) of each element, 0 to groups - 1, by `places` (m, 3) [m] and nodes `cells` (m, k).

    Cut across the longest extent, shares in proportion: sizes differ by one at most where `groups` is a power of two
    and all hangs together, else hardly more. ValueError for more groups than elements, or fewer than separate parts.
    """
    points, nodes = np.asarray(places, float), np.asarray(cells)
    if not 1 <= groups <= len(points):
        raise ValueError(f"it has {len(points)} elements: ask for fewer")
    parts = separate(nodes)
    if len(parts) > groups:
        raise ValueError(
            f"it is in {len(parts)} separate parts, which share no rotation: ask for at least as many, or make each a "
            "body"
        )
    label = np.zeros(len(points), np.int64)

    def cut(members: Ints, first: int, count: int) -> None:
        if count == 1:
            label[members] = first
            return
        left = count // 2
        halves = _halves(points[members], nodes[members], round(len(members) * left / count))
        for half, own in zip(halves, (left, count - left), strict=True):
            cut(members[half], first, own)
            first += own

    first = 0
    for part, own in zip(parts, _shares([len(each) for each in parts], groups), strict=True):
        cut(part, first, own)
        first += own
    return label


def separate(cells: Any) -> list[Ints]:
    """Elements (each an array of numbers) of the parts that hang together through shared nodes, cells (m, k)."""
    used, numbers = np.unique(np.asarray(cells), return_inverse=True)
    corners = numbers.reshape(np.shape(cells))
    ties = np.stack([np.repeat(corners[:, 0], corners.shape[1] - 1), corners[:, 1:].ravel()], axis=1)
    part = first_of_each(len(used), ties)[corners[:, 0]]
    order = np.argsort(part, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(part[order])) + 1)


def _halves(points: Any, cells: Any, size: int) -> tuple[Ints, Ints]:
    """The first `size` elements and the rest, across the longest extent that leaves both in one piece, if one does."""
    found = None
    for axis in np.argsort(-np.ptp(points, axis=0), kind="stable"):
        order = np.argsort(points[:, axis], kind="stable")
        halves = order[:size], order[size:]
        found = found or halves
        if all(len(separate(cells[half])) == 1 for half in halves):
            return halves
    assert found is not None
    return found


def _shares(sizes: list[int], count: int) -> list[int]:
    """`count` groups among parts of these sizes: one at least each, the others where groups are largest."""
    shares = [1] * len(sizes)
    for _ in range(count - len(sizes)):
        shares[max(range(len(sizes)), key=lambda k: sizes[k] / shares[k])] += 1
    return shares
