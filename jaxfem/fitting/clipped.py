"""Coordinates that stand at the end of their range while all else moves on: of a sensor, of the view, or at a stop.

They move into a value, stand at it to the last digit for some rows, and move out of it again, and never go beyond. A
body that lies against a stop does so too, where digits are coarse: samples are named, and stay.
"""

from collections.abc import Iterator

import numpy as np

from jaxfem.fitting.recording import Recording, rows_in_words

ROWS = 3  # of the very same value at the end of the range
INTO = 8.0  # times the smallest change nearby: what turns by itself and is rounded comes and goes by less
NEARBY = 0.3  # of the range: floating digits are as coarse there as at its end
BY_CHANCE = 0.1  # share of rows that repeat the one before elsewhere: more is coarse digits, or no noise at all
AXES = "xyz"


def ends_of_range(recording: Recording) -> Iterator[str]:
    """In words, the samples of markers that stand at the end of a range, where anything else moves."""
    positions = recording.positions
    moves = np.asarray((np.nan_to_num(np.abs(np.diff(positions, axis=0))) > 0).any(axis=(1, 2)))
    for m, name in enumerate(recording.names):
        for axis, values in zip(AXES, positions[:, m].T, strict=True):
            for end, limit in (("largest", np.nanmax), ("smallest", np.nanmin)):
                if np.isfinite(values).any() and (rows := _at_end(values, float(limit(values)), moves)).any():
                    which = rows_in_words(rows, recording)
                    yield f"{name}: {which}: {axis} comes fast to its {end} value and stays a while"


def end_faults(recording: Recording) -> list[str]:
    """The same as what is wrong, for a scene in which nothing stops a body."""
    found = list(ends_of_range(recording))
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    advice = "blank the samples where a sensor's range or the view ends, or give the scene what the body lies against"
    return [f"the range: {found[0]}{more}, and nothing in the scene stops it: {advice}"] if found else []


def _at_end(values: np.ndarray, limit: float, moves: np.ndarray) -> np.ndarray:
    """Rows (T,) of runs at the limit that are come into and gone out of as fast as elsewhere."""
    change = np.abs(np.diff(values))
    at_limit = values == limit
    elsewhere = np.isfinite(change) & ~(at_limit[1:] & at_limit[:-1])
    near = np.abs(values - limit) <= NEARBY * (np.nanmax(values) - np.nanmin(values))
    digit = change[elsewhere & (change > 0) & near[1:] & near[:-1]].min(initial=np.inf)
    found = np.zeros(len(values), bool)
    if not elsewhere.any() or (change[elsewhere] == 0).mean() > BY_CHANCE:
        return found
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_limit.astype(int), [0]])))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        inside = 0 < start and stop < len(values) and moves[start : stop - 1].all()
        if inside and stop - start >= ROWS and min(change[start - 1], change[stop - 1]) > INTO * digit:
            found[start:stop] = True
    return found
