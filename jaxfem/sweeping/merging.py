"""One table of all shards, read some at a time: memory does not grow with the number of variants."""

import csv
import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.order import stretches
from jaxfem.sweeping.result import FEW, columns
from jaxfem.sweeping.samples import Variants
from jaxfem.sweeping.shards import Manifest, missing, read_shard

TABLES = ("csv", "parquet")
ARRAYS = ("npy", "zarr")
Arrays = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Merged:
    """What was written: `files`, how many of the variants had each status, in words, and how many kinds of `makers`
    computed them: versions, flags, processors."""

    files: list[Path]
    statuses: dict[str, int]
    makers: int = 1


def merge(folder: Path, manifest: Manifest, variants: Variants, table: str = "csv", arrays: str = "npy") -> Merged:
    """results.csv (or .parquet): a row a variant, with variables, status and small outputs; of each output of more
    than 12 numbers an array (V, ...) in arrays/. SweepError where shards are missing, repeated or of another sweep."""
    if lost := missing(folder, manifest):
        raise SweepError(f"{len(lost)} of {manifest.shards} shards are missing in {folder}: run the sweep again")
    rows, large = _Table(folder / f"results.{table}", table), dict[str, Any]()
    statuses, makers, last = dict[str, int](), set[str](), -1
    try:
        for stretch in _stretches(manifest):
            own, outputs, told, words, by = _together(folder, manifest, stretch)
            makers |= by
            for code in told["status"].tolist():
                statuses[words[code]] = statuses.get(words[code], 0) + 1
            said = np.array([words[code] if code else "" for code in told["status"].tolist()])
            values = {name: each[own.start : own.stop] for name, each in variants.items()}
            rows.add(columns({"variant": np.arange(own.start, own.stop)}, values, told, {"problem": said}, outputs))
            for name, each in outputs.items():
                if each[0].size > FEW:
                    if name not in large:
                        plain = _plain(name, {path.stem for path, _ in large.values()})
                        large[name] = _array(folder, plain, (manifest.count, *each.shape[1:]), each.dtype, arrays)
                    large[name][1][own.start : own.stop] = each
            last = own.stop
    finally:
        rows.close()
    if last != manifest.count:
        raise SweepError(f"the shards hold {last} variants, not {manifest.count}")
    rows.keep()
    return Merged([rows.path, *(path for path, _ in large.values())], statuses, len(makers))


def _stretches(manifest: Manifest) -> list[range]:
    """Numbers of shards that together hold a whole range of variants."""
    numbers = range(manifest.shards)
    if manifest.order is None:
        return [range(number, number + 1) for number in numbers]
    return stretches(np.array(manifest.order), [manifest.rows(number).stop for number in numbers])


def _together(
    folder: Path, manifest: Manifest, numbers: range
) -> tuple[range, Arrays, Arrays, dict[int, str], set[str]]:
    """(variants, outputs, told, what statuses say, what computed them) of some shards, in the caller's order."""
    found = [read_shard(folder, manifest, number) for number in numbers]
    members = np.concatenate([manifest.members(number) for number in numbers])
    back = np.argsort(members)
    outputs, told = (
        {name: np.concatenate([each[part][name] for each in found])[back] for name in found[0][part]} for part in (0, 1)
    )
    words = {int(code): word for _, _, about in found for code, word in about["statuses"].items()}
    own = range(int(members.min()), int(members.max()) + 1)
    return own, outputs, told, words, {json.dumps(about["made_by"], sort_keys=True) for _, _, about in found}


class _Table:
    """Rows of columns, written as they come under another name, until they are all there."""

    def __init__(self, path: Path, kind: str):
        self.writer: Any
        self.path, self.kind, self.writer = path, kind, _parquet() if kind == "parquet" else (None, None)
        self.part = path.with_name(f"{path.name}.part")
        self.file: Any = self.part.open("w", newline="", encoding="utf-8") if kind == "csv" else None
        self.open: Any = None

    def add(self, found: dict[str, np.ndarray]) -> None:
        if self.file is not None:
            rows = csv.writer(self.file, lineterminator="\n")
            if self.open is None:
                rows.writerow(found)
            self.open = True
            for row in zip(*(each.tolist() for each in found.values()), strict=True):
                rows.writerow([repr(value) if isinstance(value, float) else value for value in row])
            return
        arrow, parquet = self.writer
        piece = arrow.table(found)
        if self.open is None:
            self.open = parquet.ParquetWriter(self.part, piece.schema)
        self.open.write_table(piece)

    def close(self) -> None:
        if self.file is not None:
            self.file.close()
        elif self.open is not None:
            self.open.close()

    def keep(self) -> None:
        os.replace(self.part, self.path)


def _parquet() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise SweepError("a Parquet table needs pyarrow: pip install 'jaxfem[sweeps]', or table = \"csv\"") from None
    return pyarrow, pyarrow.parquet


def _plain(name: str, taken: set[str]) -> str:
    """A name of a file for an output's, which no other has."""
    plain = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in name)
    return next(each for each in (plain, *(f"{plain}_{number}" for number in range(2, 9999))) if each not in taken)


def _array(folder: Path, name: str, shape: tuple[int, ...], dtype: Any, kind: str) -> tuple[Path, Any]:
    """An array on disk to write rows into."""
    (folder / "arrays").mkdir(exist_ok=True)
    if kind == "npy":
        path = folder / "arrays" / f"{name}.npy"
        return path, np.lib.format.open_memmap(path, "w+", dtype, shape)
    try:
        import zarr
    except ImportError:
        raise SweepError("Zarr arrays need zarr: pip install 'jaxfem[sweeps]', or arrays = \"npy\"") from None
    path = folder / "arrays" / f"{name}.zarr"
    chunks = (min(shape[0], max(1, 10_000_000 // max(1, int(np.prod(shape[1:])) * dtype.itemsize))), *shape[1:])
    return path, zarr.open(str(path), mode="w", shape=shape, chunks=chunks, dtype=dtype)
