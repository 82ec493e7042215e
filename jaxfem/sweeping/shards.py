"""A sweep on disk: a manifest, a file a chunk, and one table of them all. A run that was killed goes on with what is
missing; a file is whole or not there."""

import dataclasses
import hashlib
import json
import os
import platform
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

MANIFEST, FOLDER = "manifest.json", "shards"


@dataclasses.dataclass(frozen=True)
class Manifest:
    """What a folder's shards are of: `digest` of the definition, `count` of variants, `width` of a shard, the `engine`
    and the `reason` for it, the sample's `seed`."""

    digest: str
    count: int
    width: int
    engine: str
    reason: str
    seed: int | None = None

    @property
    def shards(self) -> int:
        """How many files there are in the end."""
        return -(-self.count // self.width)


def digest(definition: str, variants: Variants) -> str:
    """A hash of the text that defines a sweep, and of all its values."""
    found = hashlib.sha256(definition.encode())
    for name, values in variants.items():
        found.update(name.encode())
        found.update(np.ascontiguousarray(values, np.float64).tobytes())
    return found.hexdigest()[:16]


def write_manifest(folder: Path, manifest: Manifest, fresh: bool) -> None:
    """Begin a folder, or go on in one: SweepError where what is there is of another sweep. `fresh` removes that."""
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    path = folder / MANIFEST
    if fresh:
        for old in (folder / FOLDER).glob("shard_*"):
            old.unlink()
    elif path.is_file() and (found := read_manifest(folder)).digest != manifest.digest:
        raise SweepError(
            f"{folder} holds shards of another sweep, or of other files ({found.digest}, not {manifest.digest}): "
            "give --force to begin anew, or --out FOLDER for another place"
        )
    _replace(path, (json.dumps(dataclasses.asdict(manifest), indent=2) + "\n").encode())


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a folder."""
    path = folder / MANIFEST
    if not path.is_file():
        raise SweepError(f"there is no {path}: the sweep was not begun")
    return Manifest(**json.loads(path.read_text(encoding="utf-8")))


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
        write_shard(shard_path(folder, number), manifest, made.rows(number), outputs, told)
        yield number


def write_shard(path: Path, manifest: Manifest, rows: range, outputs: dict[str, Any], told: dict[str, Any]) -> None:
    """One file: values, statuses, and by what they were computed. The same values give the same bytes."""
    words = {int(code): describe(int(code)) for code in np.unique(told["status"])}
    about = {"digest": manifest.digest, "rows": [rows.start, rows.stop], "statuses": words, "made_by": made_by()}
    arrays = {f"out:{name}": each for name, each in outputs.items()} | {f"told:{n}": each for n, each in told.items()}
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    with temporary.open("wb") as file:
        np.savez(file, about=np.array(json.dumps(about)), **arrays)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def read_shard(path: Path, manifest: Manifest) -> tuple[range, dict[str, np.ndarray], dict[str, np.ndarray], Any]:
    """(rows, outputs, told, about) of a file; SweepError where it is of another sweep."""
    with np.load(path) as saved:
        about = json.loads(str(saved["about"]))
        if about["digest"] != manifest.digest:
            raise SweepError(f"{path} is of another sweep ({about['digest']}): give --force to begin anew")
        parts: list[dict[str, np.ndarray]] = [
            {name.partition(":")[2]: saved[name] for name in saved.files if name.startswith(kind)}
            for kind in ("out:", "told:")
        ]
    return range(*about["rows"]), parts[0], parts[1], about


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
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    temporary.write_bytes(content)
    os.replace(temporary, path)
