"""One table of all shards, read one after another: memory does not grow with the number of variants."""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.result import FEW, columns
from jaxfem.sweeping.samples import Variants
from jaxfem.sweeping.shards import Manifest, missing, read_shard, shard_path

TABLES = ("csv", "parquet")
ARRAYS = ("npy", "zarr")


@dataclasses.dataclass(frozen=True)
class Merged:
    """What was written: `files`, and how many of the variants had each status, in words."""

    files: list[Path]
    statuses: dict[str, int]


def merge(folder: Path, manifest: Manifest, variants: Variants, table: str = "csv", arrays: str = "npy") -> Merged:
    """results.csv (or .parquet): a row a variant, with variables, status and small outputs; of each output of more
    than 12 numbers an array (V, ...) in arrays/. SweepError where shards are missing, repeated or of another sweep."""
    if lost := missing(folder, manifest):
        raise SweepError(f"{len(lost)} of {manifest.shards} shards are missing in {folder}: run the sweep again")
    rows, large = _Table(folder / f"results.{table}", table), dict[str, Any]()
    statuses, expected = dict[str, int](), 0
    try:
        for number in range(manifest.shards):
            own, outputs, told, about = read_shard(shard_path(folder, number), manifest)
            if own.start != expected:
                raise SweepError(f"shard {number} holds variants from {own.start} on, not from {expected}")
            expected = own.stop
            for code in told["status"].tolist():
                word = about["statuses"][str(code)]
                statuses[word] = statuses.get(word, 0) + 1
            words = np.array([about["statuses"][str(code)] if code else "" for code in told["status"].tolist()])
            index = {"variant": np.arange(own.start, own.stop)}
            values = {name: each[own.start : own.stop] for name, each in variants.items()}
            rows.add(columns(index, values, told, {"problem": words}, outputs))
            for name, each in outputs.items():
                if each[0].size > FEW:
                    if name not in large:
                        large[name] = _array(folder, name, (manifest.count, *each.shape[1:]), each.dtype, arrays)
                    large[name][1][own.start : own.stop] = each
    finally:
        rows.close()
    if expected != manifest.count:
        raise SweepError(f"the shards hold {expected} variants, not {manifest.count}")
    return Merged([rows.path, *(path for path, _ in large.values())], statuses)


class _Table:
    """Rows of columns, written as they come."""

    def __init__(self, path: Path, kind: str):
        self.writer: Any
        self.path, self.kind, self.writer = path, kind, _parquet() if kind == "parquet" else (None, None)
        self.file: Any = path.open("w", newline="", encoding="utf-8") if kind == "csv" else None
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
            self.open = parquet.ParquetWriter(self.path, piece.schema)
        self.open.write_table(piece)

    def close(self) -> None:
        if self.file is not None:
            self.file.close()
        elif self.open is not None:
            self.open.close()


def _parquet() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise SweepError("a Parquet table needs pyarrow: pip install 'jaxfem[sweeps]', or table = \"csv\"") from None
    return pyarrow, pyarrow.parquet


def _array(folder: Path, name: str, shape: tuple[int, ...], dtype: Any, kind: str) -> tuple[Path, Any]:
    """An array on disk to write rows into."""
    (folder / "arrays").mkdir(exist_ok=True)
    plain = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in name)
    if kind == "npy":
        path = folder / "arrays" / f"{plain}.npy"
        return path, np.lib.format.open_memmap(path, "w+", dtype, shape)
    try:
        import zarr
    except ImportError:
        raise SweepError("Zarr arrays need zarr: pip install 'jaxfem[sweeps]', or arrays = \"npy\"") from None
    path = folder / "arrays" / f"{plain}.zarr"
    chunks = (min(shape[0], max(1, 10_000_000 // max(1, int(np.prod(shape[1:])) * dtype.itemsize))), *shape[1:])
    return path, zarr.open(str(path), mode="w", shape=shape, chunks=chunks, dtype=dtype)
