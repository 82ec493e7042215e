"""Sensitivity indices: which share of an output's variance each variable has, alone and with all others (Sobol' 1993).

Samples and estimates are SALib's (Saltelli et al. 2010): for d variables count (d + 2) variants.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.result import SweepResult, columns, write_csv
from jaxfem.sweeping.samples import Variants, _between, _counted, checked

NOTHING = 1e-12
"""Of an output's size: a scatter that is none."""


class Index(NamedTuple):
    """Share of the variance by a variable alone, `first`, and in all that it takes part in, `total`, each with the half
    width of its 95 % interval."""

    first: float
    first_bar: float
    total: float
    total_bar: float


def sobol(ranges: Mapping[str, Any], count: int, seed: int = 0) -> Variants:
    """The variants that `sensitivity_indices` takes: `count`, a power of 2, times (variables + 2); ranges as for
    `random`. SweepError without SALib."""
    count = _counted(count)
    if count & (count - 1):
        raise SweepError(f"count is {count}; for Sobol' samples give a power of 2, like 64 or 1024")
    if not ranges:
        raise SweepError("Sobol' samples need at least one name with its range, like {'young': (1e5, 2e5)}")
    drawn = _salib().sample.sobol.sample(_problem(list(ranges)), count, calc_second_order=False, seed=seed)
    return _between(ranges, np.asarray(drawn))


def sensitivity_indices(
    variants: Mapping[str, Any], outputs: Mapping[str, Any], status: Any = None, seed: int = 0
) -> dict[str, dict[str, Index]]:
    """Output -> variable -> `Index`, of variants from `sobol` and their outputs of at most 12 numbers (V, ...) each.

    SweepError where variants are others, some failed by their `status`, or an output does not vary. `seed`: of the
    resampling behind the intervals.
    """
    variants = checked(variants)
    names, values = list(variants), _designed(variants)
    if status is not None and np.any(status):
        raise SweepError(
            f"{int(np.sum(np.asarray(status) != 0))} of {len(values)} variants failed, and indices need all of them: "
            "narrow the ranges, or give halvings"
        )
    found = {}
    for output, column in columns({name: np.asarray(each) for name, each in outputs.items()}).items():
        if not np.isfinite(column).all():
            raise SweepError(f'the output "{output}" is not finite for some variants: it has no indices')
        if not np.ptp(column) > NOTHING * np.abs(column).max():
            raise SweepError(f'the output "{output}" is the same for all variants: it has no indices')
        scaled = (column.astype(float) - column.mean()) / column.std()
        again = seed + 1  # SALib takes 0 for no seed
        made = _salib().analyze.sobol.analyze(_problem(names), scaled, calc_second_order=False, seed=again)
        rows = zip(*(made[key] for key in ("S1", "S1_conf", "ST", "ST_conf")), strict=True)
        found[output] = {name: Index(*map(float, row)) for name, row in zip(names, rows, strict=True)}
    return found


def indices_of(result: SweepResult, seed: int = 0) -> dict[str, dict[str, Index]]:
    """The indices of a sweep's result: see `sensitivity_indices`."""
    return sensitivity_indices(result.variants, result.outputs, result.status, seed)


def write_indices(path: Any, found: Mapping[str, Mapping[str, Index]]) -> Any:
    """A CSV file, a row for each output and variable."""
    rows = [(output, name, *index) for output, each in found.items() for name, index in each.items()]
    heads = ("output", "variable", *Index._fields)
    return write_csv(
        path, {head: np.array(column) for head, column in zip(heads, zip(*rows, strict=True), strict=True)}
    )


def _designed(variants: Variants) -> np.ndarray:
    """Values (V, d) in Saltelli's order: a row, then it with each variable in turn of a second, then the second."""
    if any(each.ndim != 1 for each in variants.values()):
        raise SweepError("indices take variables of one number a variant")
    values = np.stack(list(variants.values()), 1)
    count, wide = values.shape[1] + 2, values.shape[1]
    good = len(values) % count == 0
    if good:
        blocks = values.reshape(-1, count, wide)
        own = np.eye(wide, dtype=bool)
        mixed = np.where(own, blocks[:, -1, None], blocks[:, :1])
        good = bool((mixed == blocks[:, 1:-1]).all())
    if not good:
        raise SweepError("indices take variants that sweeping.sobol drew, all of them and in their order")
    return values


def _problem(names: list[str]) -> dict[str, Any]:
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def _salib() -> Any:
    try:
        import SALib
        import SALib.analyze.sobol
        import SALib.sample.sobol
    except ImportError:
        raise SweepError("Sobol' samples and indices need SALib: pip install 'jaxfem[indices]'") from None
    return SALib
