"""Variants: name -> values (V, ...), from a grid, drawn at random, by Latin hypercube, or from a table."""

import csv
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.sweeping.errors import SweepError

Variants = dict[str, np.ndarray]
LOG = "log"
MOST = 10**8
"""Variants of a sweep: their values are in memory."""


def grid(axes: Mapping[str, Any]) -> Variants:
    """Every combination of the values (k,) of each name; the last name runs fastest."""
    if not named(axes, "a grid"):
        raise SweepError("a grid needs at least one name with its values, like {'young': [1e5, 2e5]}")
    values = [_axis(name, each) for name, each in axes.items()]
    _counted(math.prod(each.size for each in values))
    crossed = np.meshgrid(*values, indexing="ij")
    return {name: each.ravel() for name, each in zip(axes, crossed, strict=True)}


def random(ranges: Mapping[str, Any], count: int, seed: int = 0) -> Variants:
    """`count` variants, each name drawn by itself between its bounds: (low, high), or (low, high, "log") for even
    shares of each decade. The same `seed` gives the same."""
    drawn = _generator(seed).random((_counted(count), len(named(ranges, "the ranges"))))
    return _between(ranges, drawn)


def latin_hypercube(ranges: Mapping[str, Any], count: int, seed: int = 0) -> Variants:
    """The same bounds, and each name meets each `count`-th part of its range exactly once (McKay et al. 1979)."""
    from scipy.stats import qmc

    sampler = qmc.LatinHypercube(d=max(len(named(ranges, "the ranges")), 1), rng=_generator(seed))
    return _between(ranges, sampler.random(_counted(count))[:, : len(ranges)])


def table(source: Any) -> Variants:
    """Variants of a CSV file whose head has the names, or of a mapping name -> (V, ...) values."""
    if isinstance(source, Mapping):
        return checked(source)
    if not isinstance(source, str | os.PathLike):
        raise SweepError(f"{source!r} is no table: give the path of a CSV file, or name -> values")
    path = Path(source)
    if not path.is_file():
        raise SweepError(f"there is no table {path}: give a CSV file with the names of the variables in its first line")
    (_, head), *rows = _lines(path)
    head = [name.strip() for name in head]
    if not rows:
        raise SweepError(f"{path} has no variants: its first line names the variables, and each further one is one")
    if len(set(head)) < len(head):
        raise SweepError(f"the first line of {path} names a variable twice: {', '.join(head)}")
    for line, row in rows:
        if len(row) != len(head):
            raise SweepError(f"line {line} of {path} has {len(row)} cells, and the first one {len(head)} names")
    numbers = np.array([[_cell(path, line, *each) for each in zip(head, row, strict=True)] for line, row in rows])
    return checked({name: numbers[:, place] for place, name in enumerate(head)})


def checked(variants: Mapping[str, Any]) -> Variants:
    """The variants as arrays of one length; SweepError where there is none, or lengths differ."""
    made = {name: _array(name, each) for name, each in named(variants, "the variants").items()}
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


def named(given: Any, what: str) -> Mapping[str, Any]:
    """What was given, a mapping; SweepError for anything else."""
    if not isinstance(given, Mapping):
        raise SweepError(f"{what} are {given!r}; give a mapping from names, like {{'young': ...}}")
    return given


def _axis(name: str, values: Any) -> np.ndarray:
    try:
        found = np.atleast_1d(np.asarray(values, float))
    except (TypeError, ValueError):
        raise SweepError(f'the grid\'s values of "{name}" are {values!r}; give a list of numbers') from None
    if found.ndim != 1 or not found.size:
        raise SweepError(f'the grid\'s values of "{name}" have shape {found.shape}; give a list of numbers')
    return found


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """The lines of a CSV file that hold something, with their numbers; a blank one where there is none."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets begin a file with a mark
            reader = csv.reader(file)
            return [(reader.line_num, row) for row in reader if any(map(str.strip, row))] or [(1, [])]
    except (UnicodeDecodeError, csv.Error) as problem:
        raise SweepError(f"{path} is no CSV file of UTF-8 text: {problem}") from None


def _cell(path: Path, line: int, name: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise SweepError(f'"{name}" in line {line} of {path} is {cell!r}, which is no number') from None


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
    if count > MOST:
        raise SweepError(f"{count} variants are more than the {MOST} that a sweep takes: draw some of them")
    return int(count)


def _generator(seed: Any) -> np.random.Generator:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise SweepError(f"seed is {seed!r}; give a whole number, at least 0")
    return np.random.default_rng(seed)


def _between(ranges: Mapping[str, Any], shares: np.ndarray) -> Variants:
    made = {}
    for place, (name, bounds) in enumerate(ranges.items()):
        low, high, log = _bounds(name, bounds)
        share = shares[:, place]
        made[name] = low * (high / low) ** share if log else low + (high - low) * share
    return checked(made)


def _bounds(name: str, bounds: Any) -> tuple[float, float, bool]:
    given = tuple(bounds) if isinstance(bounds, tuple | list | np.ndarray) else ()
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
