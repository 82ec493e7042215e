"""A sweep on disk: a manifest, a file a chunk, and one table of them all. A run that was killed goes on with what is
missing; a file is whole or not there."""

import dataclasses
import hashlib
import json
import os
import platform
import shutil
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxlib import version as jaxlib_version

from jaxfem.solvers.status import describe
from jaxfem.sweeping.chunks import Sweep
from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.samples import Variants

MANIFEST, FOLDER, ARRAYS = "manifest.json", "shards", "arrays"
MERGED = ("results.csv", "results.parquet", "indices.csv", "responses.png", "pairs.png")
"""Files that are made of all shards, beside those in the folder of arrays."""


@dataclasses.dataclass(frozen=True)
class Manifest:
    """What a folder's shards are of: `digest` of the definition, `count` of variants, `width` of a shard, the `engine`
    and the `reason` for it, the sample's `seed`; in which `order` shards hold variants, None: their own."""

    digest: str
    count: int
    width: int
    engine: str
    reason: str
    seed: int | None = None
    order: tuple[int, ...] | None = None

    @property
    def shards(self) -> int:
        """How many files there are in the end."""
        return -(-self.count // self.width)

    def rows(self, shard: int) -> range:
        """Which places in the order a shard holds."""
        return range(shard * self.width, min((shard + 1) * self.width, self.count))

    def members(self, shard: int) -> np.ndarray:
        """Numbers of the variants that a shard holds, row by row."""
        rows = self.rows(shard)
        return np.arange(rows.start, rows.stop) if self.order is None else np.array(self.order[rows.start : rows.stop])

    def text(self) -> str:
        """As JSON, the order in one line."""
        found = {name: value for name, value in dataclasses.asdict(self).items() if name != "order"}
        return f'{json.dumps(found, indent=2)[:-2]},\n  "order": {json.dumps(self.order)}\n}}\n'


def digest(definition: str, variants: Variants) -> str:
    """A hash of the text that defines a sweep, and of all its values."""
    found = hashlib.sha256(definition.encode())
    for name, values in variants.items():
        found.update(name.encode())
        found.update(np.ascontiguousarray(values, np.float64).tobytes())
    return found.hexdigest()[:16]


def begun(folder: Path, digest: str) -> Manifest | None:
    """The manifest of a sweep that was begun in a folder, None where none was; SweepError where it is of another."""
    if not (folder / MANIFEST).is_file():
        return None
    found = read_manifest(folder)
    if found.digest != digest:
        raise SweepError(
            f"{folder} holds shards of another sweep, or of other files ({found.digest}, not {digest}): "
            "give --force to begin anew, or --out FOLDER for another place"
        )
    return found


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Begin a folder; shards that are there go, and what was merged of them."""
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    for old in [*(folder / FOLDER).glob("shard_*"), *(folder / name for name in MERGED)]:
        old.unlink(missing_ok=True)
    shutil.rmtree(folder / ARRAYS, ignore_errors=True)
    _replace(folder / MANIFEST, manifest.text().encode())


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a folder."""
    path = folder / MANIFEST
    if not path.is_file():
        raise SweepError(f"there is no {path}: the sweep was not begun")
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return Manifest(**{**found, "order": None if found["order"] is None else tuple(found["order"])})
    except (ValueError, KeyError, TypeError):
        raise SweepError(f"{path} is no manifest of this version: give --force to begin anew") from None


def shard_path(folder: Path, number: int) -> Path:
    """The file of a chunk."""
    return folder / FOLDER / f"shard_{number:06d}.npz"


def missing(folder: Path, manifest: Manifest) -> list[int]:
    """Numbers of the shards that are not there yet."""
    return [number for number in range(manifest.shards) if not shard_path(folder, number).is_file()]


def work(made: Sweep, folder: Path, manifest: Manifest, numbers: Iterable[int]) -> Iterator[int]:
    """Compute these shards and write each: its number when it is there. All that a worker does, wherever it runs."""
    for number in numbers:
        outputs, told = made.run(number)
        write_shard(shard_path(folder, number), manifest, number, outputs, told)
        yield number


def write_shard(path: Path, manifest: Manifest, number: int, outputs: dict[str, Any], told: dict[str, Any]) -> None:
    """One file: values, statuses, and by what they were computed. The same values give the same bytes."""
    words = {int(code): describe(int(code)) for code in np.unique(told["status"])}
    members = manifest.members(number).tolist()
    about = {"digest": manifest.digest, "variants": members, "statuses": words, "made_by": made_by()}
    arrays = {f"out:{name}": each for name, each in outputs.items()} | {f"told:{n}": each for n, each in told.items()}
    part = temporary(path)
    try:
        with part.open("wb") as file:
            np.savez(file, about=np.array(json.dumps(about)), **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:  # a disk that is full
        part.unlink(missing_ok=True)


def read_shard(
    folder: Path, manifest: Manifest, number: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], Any]:
    """(outputs, told, about) of a shard; SweepError where its file is damaged, of another sweep or of others."""
    path = shard_path(folder, number)
    try:
        with np.load(path) as saved:
            about = json.loads(str(saved["about"]))
            parts: list[dict[str, np.ndarray]] = [
                {name.partition(":")[2]: saved[name] for name in saved.files if name.startswith(kind)}
                for kind in ("out:", "told:")
            ]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as problem:
        raise SweepError(f"{path} cannot be read ({problem}): remove it, and run the sweep again") from None
    if about["digest"] != manifest.digest:
        raise SweepError(f"{path} is of another sweep ({about['digest']}): give --force to begin anew")
    if (own := about["variants"]) != manifest.members(number).tolist():
        raise SweepError(f"shard {number} holds variants from {min(own)} on, and others were due: remove {path}")
    return parts[0], parts[1], about


def made_by() -> dict[str, str]:
    """Versions, flags and processor: what bits depend on."""
    import jaxfem

    return {
        "jaxfem": jaxfem.__version__,
        "jax": jax.__version__,
        "jaxlib": jaxlib_version.__version__,
        "numpy": np.__version__,
        "precision": str(np.dtype(jax.dtypes.canonicalize_dtype(np.float64))),
        "XLA_FLAGS": os.environ.get("XLA_FLAGS", ""),
        "processor": _processor(),
        "device": jax.devices()[0].device_kind,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _replace(path: Path, content: bytes) -> None:
    part = temporary(path)
    try:
        part.write_bytes(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def temporary(path: Path) -> Path:
    """Beside a file, what no other process of any machine writes."""
    return path.with_name(f"{path.name}.{platform.node()}.{os.getpid()}.part")
