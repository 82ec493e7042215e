"""What a sweep returns: outputs, a status for each variant, and tables of them."""

import csv
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.solvers.status import describe
from jaxfem.sweeping.derivatives import derivative_name
from jaxfem.sweeping.errors import SweepError

FEW = 12  # numbers of an output that a table shows side by side


@dataclasses.dataclass(frozen=True)
class SweepResult:
    """`variants` and `outputs` by name, (V, ...) each; of each variant `status` (0: converged; see
    `jaxfem.solvers.describe`), most `iterations` and largest `residual` of a step, `inverted` elements. `engine`, and
    the `reason` for it; `seconds` spent in all, of which `compiling`.
    """

    variants: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    status: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    inverted: np.ndarray
    engine: str
    reason: str
    seconds: float
    compiling: float

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, name: str) -> np.ndarray:
        """An output (V, ...) by its name."""
        if name not in self.outputs:
            raise SweepError(f"there is no output {name!r}: there are {', '.join(self.outputs)}")
        return self.outputs[name]

    def derivative(self, output: str, variable: str) -> np.ndarray:
        """Of an output in a variable that the sweep was asked to differentiate in, (V, *output, *variable)."""
        return self[derivative_name(output, variable)]

    def samples(self, output: str) -> tuple[np.ndarray, np.ndarray]:
        """(X (g, d), Y (g, ...)) of the g variants that converged: what a surrogate of one's choice is fitted to."""
        values = [each.reshape(len(each), -1) for each in self.variants.values()]
        return np.concatenate(values, 1)[self.good], self[output][self.good]

    @property
    def good(self) -> np.ndarray:
        """Which variants converged at every step, (V,)."""
        found: np.ndarray = self.status == 0
        return found

    def columns(self) -> dict[str, np.ndarray]:
        """Name -> one number a variant: variables, status, iterations, and each output of at most 12 numbers."""
        return columns(self.variants, {"status": self.status, "iterations": self.iterations}, self.outputs)

    def to_csv(self, path: Any) -> Path:
        """Write the columns, a row a variant."""
        return write_csv(Path(path), self.columns())

    def __str__(self) -> str:
        return (
            f'{len(self)} variants by engine "{self.engine}" ({self.reason}) in {self.seconds:.1f} s, '
            f"{self.compiling:.1f} s of them compiling; {describe(self.status)}"
        )


def columns(*groups: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of one number a row, of arrays (V, ...) with at most `FEW` numbers a row; larger ones are left out.

    SweepError where two have one name.
    """
    found = dict[str, np.ndarray]()
    for key, each in (pair for group in groups for pair in group.items()):
        for name, column in _split(key, each):
            if name in found:
                raise SweepError(f'two columns of the table are called "{name}": give that output another name')
            found[name] = column
    return found


def _split(name: str, values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    flat = values.reshape(len(values), -1)
    if values.ndim == 1:
        yield name, values
    elif flat.shape[1] <= FEW:
        for number, place in enumerate(np.ndindex(values.shape[1:])):
            yield f"{name}[{']['.join(map(str, place))}]", flat[:, number]


def write_csv(path: Path, found: dict[str, np.ndarray]) -> Path:
    """A CSV file of columns (V,); numbers in full, so that the file gives back the same bits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(found)
        for row in zip(*(each.tolist() for each in found.values()), strict=True):
            writer.writerow([repr(value) if isinstance(value, float) else value for value in row])
    return path
