"""Variants: name -> values (V, ...), from a grid, drawn at random, by Latin hypercube, or from a table."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.sweeping.errors import SweepError

Variants = dict[str, np.ndarray]
LOG = "log"


def grid(axes: Mapping[str, Any]) -> Variants:
    """Every combination of the values (k,) of each name; the last name runs fastest."""
    if not axes:
        raise SweepError("a grid needs at least one name with its values, like {'young': [1e5, 2e5]}")
    values = [np.atleast_1d(np.asarray(each, float)) for each in axes.values()]
    for name, each in zip(axes, values, strict=True):
        if each.ndim != 1 or not each.size:
            raise SweepError(f'the grid\'s values of "{name}" have shape {each.shape}; give a list of numbers')
    crossed = np.meshgrid(*values, indexing="ij")
    return {name: each.ravel() for name, each in zip(axes, crossed, strict=True)}


def random(ranges: Mapping[str, Any], count: int, seed: int = 0) -> Variants:
    """`count` variants, each name drawn by itself between its bounds: (low, high), or (low, high, "log") for even
    shares of each decade. The same `seed` gives the same."""
    drawn = np.random.default_rng(seed).random((_counted(count), len(ranges)))
    return _between(ranges, drawn)


def latin_hypercube(ranges: Mapping[str, Any], count: int, seed: int = 0) -> Variants:
    """The same bounds, and each name meets each `count`-th part of its range exactly once (McKay et al. 1979)."""
    from scipy.stats import qmc

    sampler = qmc.LatinHypercube(d=max(len(ranges), 1), rng=np.random.default_rng(seed))
    return _between(ranges, sampler.random(_counted(count))[:, : len(ranges)])


def table(source: Any) -> Variants:
    """Variants of a CSV file whose head has the names, or of a mapping name -> (V, ...) values."""
    if isinstance(source, Mapping):
        return checked(source)
    path = Path(source)
    if not path.is_file():
        raise SweepError(f"there is no table {path}: give a CSV file with the names of the variables in its first line")
    import csv

    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets begin a file with a mark
            lines = [row for row in csv.reader(file) if row]
    except (UnicodeDecodeError, csv.Error) as problem:
        raise SweepError(f"{path} is no CSV file of UTF-8 text: {problem}") from None
    if len(lines) < 2:
        raise SweepError(f"{path} has no variants: its first line names the variables, and each further one is one")
    head, *rows = [name.strip() for name in lines[0]], *lines[1:]
    if len(set(head)) < len(head):
        raise SweepError(f"the first line of {path} names a variable twice: {', '.join(head)}")
    if any(len(row) != len(head) for row in rows):
        raise SweepError(f"the rows of {path} do not all have the {len(head)} cells of its head")
    try:
        numbers = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as problem:
        raise SweepError(f"{path} holds what is no number: {problem}") from None
    return checked({name: numbers[:, place] for place, name in enumerate(head)})


def checked(variants: Mapping[str, Any]) -> Variants:
    """The variants as arrays of one length; SweepError where there is none, or lengths differ."""
    made = {name: _array(name, each) for name, each in variants.items()}
    lengths = {name: len(each) for name, each in made.items()}
    if not lengths or not min(lengths.values()):
        raise SweepError("a sweep needs at least one name with at least one value, like {'young': [1e5, 2e5]}")
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} has {count}" for name, count in lengths.items())
        raise SweepError(f"variables differ in how many values they have: {listed}; for combinations use sweeping.grid")
    for name, each in made.items():
        if each.dtype.kind not in "fiu":
            raise SweepError(f'the values of "{name}" are no numbers but {each.dtype}')
    return made


def _array(name: Any, values: Any) -> np.ndarray:
    if not isinstance(name, str) or not name:
        raise SweepError(f"{name!r} is no name of a variable: give a word, like young or gravity[2]")
    try:
        return np.atleast_1d(np.asarray(values))
    except ValueError:  # ragged
        raise SweepError(f'the values of "{name}" have not all one shape') from None


def _counted(count: Any) -> int:
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise SweepError(f"count is {count!r}; give how many variants, a whole number of at least 1")
    return int(count)


def _between(ranges: Mapping[str, Any], shares: np.ndarray) -> Variants:
    made = {}
    for place, (name, bounds) in enumerate(ranges.items()):
        low, high, log = _bounds(name, bounds)
        share = shares[:, place]
        made[name] = low * (high / low) ** share if log else low + (high - low) * share
    return checked(made)


def _bounds(name: str, bounds: Any) -> tuple[float, float, bool]:
    given = tuple(bounds) if isinstance(bounds, tuple | list) else ()
    log = len(given) == 3 and given[2] == LOG
    try:
        low, high = (float(each) for each in given[:2])
    except (TypeError, ValueError):
        low = high = np.nan
    if not (len(given) == 2 or log) or not low < high or not np.isfinite([low, high]).all() or (log and low <= 0):
        raise SweepError(
            f'the range of "{name}" is {bounds!r}; give (low, high), or (low, high, "log") with low above 0'
        )
    return low, high, log
