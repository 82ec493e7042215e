"""Coordinates that are cut off at the end of a range: of a sensor, a view or a column's digits.

They move into a value, stand at it to the last digit for some rows, and move out of it again, and never go beyond.
"""

from collections.abc import Iterator

import numpy as np

from jaxfem.fitting.recording import Recording, rows_in_words

ROWS = 3  # of the very same value at the end of the range
INTO = 4.0  # times the smallest change: what turns by itself and is rounded comes and goes by less
BY_CHANCE = 0.1  # share of rows that repeat the one before elsewhere: more is coarse digits, or no noise at all
AXES = "xyz"


def ends_of_range(positions: np.ndarray, recording: Recording) -> Iterator[str]:
    """Cut-off samples of markers (T, M, 3) made missing, and what they are in words.

    Where nothing moves from row to row nothing is cut off: what lies still with all else lies on something.
    """
    moves = np.asarray((np.nan_to_num(np.abs(np.diff(positions, axis=0))) > 0).any(axis=(1, 2)))
    for m, name in enumerate(recording.names):
        for axis, values in zip(AXES, positions[:, m].copy().T, strict=True):
            for end, limit in (("largest", np.nanmax), ("smallest", np.nanmin)):
                if not np.isfinite(values).any() or not (rows := _cut_off(values, float(limit(values)), moves)).any():
                    continue
                positions[rows, m] = np.nan
                what = f"{axis} stands at its {end} value for rows on end, as where a range ends"
                yield f"{name}: {rows_in_words(rows, recording)}: {what}, so they are missing"


def _cut_off(values: np.ndarray, limit: float, moves: np.ndarray) -> np.ndarray:
    """Rows (T,) of runs at the limit that are come into and gone out of as fast as elsewhere."""
    change = np.abs(np.diff(values))
    at_limit = values == limit
    elsewhere = np.isfinite(change) & ~(at_limit[1:] & at_limit[:-1])
    digit = change[elsewhere & (change > 0)].min(initial=np.inf)
    found = np.zeros(len(values), bool)
    if not elsewhere.any() or (change[elsewhere] == 0).mean() > BY_CHANCE:
        return found
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_limit.astype(int), [0]])))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        inside = 0 < start and stop < len(values) and moves[start : stop - 1].all()
        if inside and stop - start >= ROWS and min(change[start - 1], change[stop - 1]) > INTO * digit:
            found[start:stop] = True
    return found
