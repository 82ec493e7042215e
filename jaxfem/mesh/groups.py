"""Partition of nodes into compact groups of nearly equal size: recursive bisection along the longest axis."""

import numpy as np


def bisected(points: np.ndarray, count: int) -> list[np.ndarray]:
    """Split `points` (n, 3) into `count` groups, cutting along the longest axis each time: list of index arrays.

    Sizes differ by one or two: groups are padded to the largest, and the padding takes part in every product.
    """

    def split(group: np.ndarray, parts: int) -> list[np.ndarray]:
        if parts == 1:
            return [group]
        left = parts // 2
        axis = np.ptp(points[group], axis=0).argmax()
        ordered = group[np.argsort(points[group, axis], kind="stable")]
        cut = round(len(group) * left / parts)
        return split(ordered[:cut], left) + split(ordered[cut:], parts - left)

    return split(np.arange(len(points)), max(1, min(count, len(points))))


def body_groups(points: np.ndarray, node_body: np.ndarray, size: int, most: int) -> list[np.ndarray]:
    """Groups of about `size` nodes that never mix bodies, about `most` in all; each body gets at least one."""
    total = min(most, max(1, round(len(points) / size)))
    groups = []
    for body in range(int(node_body.max()) + 1):
        nodes = np.flatnonzero(node_body == body)
        share = max(1, round(total * len(nodes) / len(points)))
        groups += [nodes[g] for g in bisected(points[nodes], share)]
    return groups
