"""Elements in groups of about equal size: recursive bisection of their centroids (Simon 1991)."""

from typing import Any

import numpy as np

from .checks import Ints


def partition(places: Any, groups: int) -> Ints:
    """Group (m,) of each place (m, 3) [m], 0 to groups - 1: cut across the longest extent, shares in proportion.

    Sizes differ by one at most where `groups` is a power of two, else hardly more. ValueError for more groups than
    places.
    """
    points = np.asarray(places, float)
    if not 1 <= groups <= len(points):
        raise ValueError(f"groups is {groups}; give 1 to {len(points)}, the number of elements")
    label = np.zeros(len(points), np.int64)

    def cut(members: Ints, first: int, count: int) -> None:
        if count == 1:
            label[members] = first
            return
        axis = int(np.argmax(np.ptp(points[members], axis=0)))
        order = members[np.argsort(points[members, axis], kind="stable")]
        left = count // 2
        place = round(len(members) * left / count)
        cut(order[:place], first, left)
        cut(order[place:], first + left, count - left)

    cut(np.arange(len(points)), 0, groups)
    return label
