"""One table of all shards, read some at a time: memory does not grow with the number of variants."""

import csv
import dataclasses
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.order import stretches
from jaxfem.sweeping.result import FEW, columns
from jaxfem.sweeping.samples import Variants
from jaxfem.sweeping.shards import Manifest, missing, read_shard, temporary

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
    rows, large = _Table(folder / f"results.{table}", table), dict[str, _Array]()
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
                        plain = _plain(name, {array.path.stem for array in large.values()})
                        shape = manifest.count, *each.shape[1:]
                        large[name] = _Array(folder / "arrays" / f"{plain}.{arrays}", shape, each.dtype, arrays)
                    large[name].rows[own.start : own.stop] = each
            last = own.stop
        if last != manifest.count:
            raise SweepError(f"the shards hold {last} variants, not {manifest.count}")
        for one in (*large.values(), rows):
            one.keep()
        return Merged([rows.path, *(array.path for array in large.values())], statuses, len(makers))
    finally:  # an interruption, a damaged shard, a disk that is full
        for one in (rows, *large.values()):
            one.drop()


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


class _Part:
    """A file, or folder, that is written under another name `part`, until all is there."""

    def __init__(self, path: Path):
        self.path, self.part = path, temporary(path)

    def close(self) -> None:
        """Write what is still to be written."""

    def keep(self) -> None:
        """In place of what was there."""
        self.close()
        if self.path.is_dir():
            shutil.rmtree(self.path)
        os.replace(self.part, self.path)

    def drop(self) -> None:
        """Remove what was written and not kept."""
        try:
            self.close()
        finally:
            shutil.rmtree(self.part) if self.part.is_dir() else self.part.unlink(missing_ok=True)


class _Table(_Part):
    """Rows of columns, written as they come."""

    def __init__(self, path: Path, kind: str):
        self.writer: Any
        super().__init__(path)
        self.writer = _parquet() if kind == "parquet" else (None, None)
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
        """The table's footer."""
        for each in (self.file, self.open if self.file is None else None):
            if each is not None:
                each.close()


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


class _Array(_Part):
    """An array on disk to write `rows` into."""

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: Any, kind: str):
        self.rows: Any
        super().__init__(path)
        path.parent.mkdir(exist_ok=True)
        try:
            self.rows = (_npy if kind == "npy" else _zarr)(self.part, shape, dtype)
        except BaseException:
            self.drop()
            raise

    def close(self) -> None:
        """The map of the file goes."""
        self.rows = None


def check_writers(table: str, arrays: str) -> None:
    """SweepError where a package is missing that these kinds of files need: before a sweep, not after it."""
    if table == "parquet":
        _parquet()
    if arrays == "zarr":
        _zarr_module()


def _npy(path: Path, shape: tuple[int, ...], dtype: Any) -> Any:
    made = np.lib.format.open_memmap(path, "w+", dtype, shape)
    if hasattr(os, "posix_fallocate"):  # a disk that is full then has an error here; later it would kill the process
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    return made


def _zarr_module() -> Any:
    try:
        import zarr
    except ImportError:
        raise SweepError("Zarr arrays need zarr: pip install 'jaxfem[sweeps]', or arrays = \"npy\"") from None
    return zarr


def _zarr(path: Path, shape: tuple[int, ...], dtype: Any) -> Any:
    chunks = (min(shape[0], max(1, 10_000_000 // max(1, int(np.prod(shape[1:])) * dtype.itemsize))), *shape[1:])
    return _zarr_module().open(str(path), mode="w", shape=shape, chunks=chunks, dtype=dtype)
