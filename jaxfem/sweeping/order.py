"""In which order variants go through chunks: those that take about as many iterations together, so that few wait long.

The lanes of a chunk end a step when the last of them does. Variants are sorted within stretches of some chunks, not all
at once, so that results can be put back in the caller's order stretch by stretch, in little memory.
"""

import numpy as np

STRETCH = 32
"""Chunks at most whose variants are sorted among each other."""
HELD = 1e8
"""Bytes at most of the outputs of a stretch, which merging holds at one time."""


def sorted_by(costs: np.ndarray, chunk: int, bytes_each: int) -> np.ndarray:
    """The order (V,) of variants with `costs` (V,), up to any factor: dear ones first, in stretches of chunks of
    `chunk` variants, of `bytes_each` of outputs. Variants whose cost is not finite, which mostly fail, come last."""
    stretch = chunk * int(np.clip(HELD // max(1, bytes_each * chunk), 1, STRETCH))
    keys = np.where(np.isfinite(costs), -np.asarray(costs, np.float64), np.inf)
    starts = range(0, len(keys), stretch)
    return np.concatenate([at + np.argsort(keys[at : at + stretch], kind="stable") for at in starts])


def stretches(order: np.ndarray, ends: list[int]) -> list[range]:
    """Numbers of chunks, which end at `ends` (c,) in the order (V,), that together hold a whole range of variants."""
    last = np.maximum.accumulate(order)[np.asarray(ends) - 1]
    made, first = list[range](), 0
    for number, (highest, end) in enumerate(zip(last.tolist(), ends, strict=True)):
        if highest == end - 1:
            made.append(range(first, number + 1))
            first = number + 1
    return made
