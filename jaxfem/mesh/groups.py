"""Partition of nodes into compact groups of nearly equal size: recursive bisection along the longest axis."""

import numpy as np


def bisected(points: np.ndarray, count: int) -> list[np.ndarray]:
    """Split `points` (n, 3) into `count` groups by halving the largest along its longest axis: list of index arrays."""
    groups = [np.arange(len(points))]
    while len(groups) < min(count, len(points)):
        largest = max(range(len(groups)), key=lambda i: len(groups[i]))
        group = groups.pop(largest)
        axis = np.ptp(points[group], axis=0).argmax()
        ordered = group[np.argsort(points[group, axis], kind="stable")]
        groups += [ordered[: len(ordered) // 2], ordered[len(ordered) // 2 :]]
    return groups


def body_groups(points: np.ndarray, node_body: np.ndarray, size: int, most: int) -> list[np.ndarray]:
    """Groups of about `size` nodes that never mix bodies, about `most` in all; each body gets at least one."""
    total = min(most, max(1, round(len(points) / size)))
    groups = []
    for body in range(int(node_body.max()) + 1):
        nodes = np.flatnonzero(node_body == body)
        share = max(1, round(total * len(nodes) / len(points)))
        groups += [nodes[g] for g in bisected(points[nodes], share)]
    return groups
