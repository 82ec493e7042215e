"""`jaxfem sweep`: thousands of variants of a scene file, by one process a core; a run that was killed goes on."""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxfem.cli.exits import FAILED, INTERRUPTED
from jaxfem.cli.messages import error, warning
from jaxfem.cli.progress import Progress
from jaxfem.io.plots import PlotError
from jaxfem.io.sweep_files import SweepFile, load_sweep
from jaxfem.io.sweep_plots import plot_pairs, plot_responses
from jaxfem.solvers import describe
from jaxfem.sweeping.chunks import Sweep
from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.indices import sensitivity_indices, write_indices
from jaxfem.sweeping.merging import Merged, check_writers, merge
from jaxfem.sweeping.result import columns
from jaxfem.sweeping.shards import Manifest, begun, missing, read_manifest, read_shard, work, write_manifest

ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
LOOK = 0.2  # s between looks at what is there


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "sweep",
        help="run thousands of variants of a scene",
        description="Run variants of a scene. A run that was interrupted or killed goes on where it is called again.",
    )
    parser.add_argument("file", metavar="FILE.toml", help="the sweep: scene, values, outputs")
    parser.add_argument("--out", metavar="FOLDER", help="where results go, instead of [output] folder")
    parser.add_argument("--processes", type=_whole, metavar="N", help="how many, instead of [sweep] processes")
    parser.add_argument("--force", action="store_true", help="replace the results of an earlier sweep")
    parser.add_argument("--no-plots", action="store_true", help="write no PNG files")
    parser.add_argument(
        "--worker", type=_share, metavar="K/N", help="compute every N-th missing shard from the K-th on, and no more"
    )
    parser.add_argument("--begin", action="store_true", help="check the files, write the manifest, and no more")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run what is missing and merge it; 0 at the end, 3 when a process failed or no variant converged, 130 when
    interrupted."""
    file = load_sweep(args.file)
    check_writers(file.table, file.arrays)
    if file.scene.precision == "float64":
        jax.config.update("jax_enable_x64", True)
    folder = Path(args.out) if args.out else file.folder
    if args.worker:
        return _worker(file, folder, args.worker)
    manifest = None if args.force else begun(folder, file.digest)
    if manifest is None:
        manifest = _planned(file)
        write_manifest(folder, manifest)
    if args.begin:
        print(f"{manifest.count} variants in {manifest.shards} shards, {len(missing(folder, manifest))} missing")
        return 0
    todo, start = len(missing(folder, manifest)), time.perf_counter()
    processes = min(args.processes or file.processes or os.cpu_count() or 1, max(todo, 1))
    try:
        problem = _watched(args.file, folder, manifest, processes) if todo else ""
    except KeyboardInterrupt:
        error(f"interrupted with {manifest.shards - len(missing(folder, manifest))} of {manifest.shards} shards there")
        return INTERRUPTED
    if problem:
        error(problem)
        return FAILED
    merged = merge(folder, manifest, file.variants, file.table, file.arrays)
    if file.indices:
        merged.files.extend(_indices(file, folder, manifest))
    merged.files.extend(_plots(file, folder, manifest) if file.plots and not args.no_plots else [])
    print(_summary(file, manifest, merged, todo, time.perf_counter() - start, processes, folder))
    if describe(0) in merged.statuses:
        return 0
    error("no variant converged: see the problem of each in the table")
    return FAILED


def _planned(file: SweepFile) -> Manifest:
    """What a folder will hold: all that can be wrong with a file shows here."""
    made = prepared(file, file.engine, file.width)
    order = None if made.order is None else tuple(made.order.tolist())
    return Manifest(file.digest, made.count, made.width, made.engine.name, made.reason, file.seed, order)


def prepared(file: SweepFile, engine: str, width: int | None, order: np.ndarray | None = None) -> Sweep:
    """The sweep of a file."""
    scene = file.scene
    return Sweep(
        *scene.build(),
        file.variants,
        dt=scene.dt,
        steps=scene.steps,
        every=scene.every if scene.steps % scene.every == 0 else 1,
        halvings=scene.halvings,
        outputs=file.outputs,
        derivatives=file.derivatives,
        engine=engine,
        width=width,
        devices=jax.local_devices()[:1],
        order=order,
    )


def _whole(word: str) -> int:
    """A whole number of at least 1."""
    if not word.isdecimal() or int(word) < 1:
        raise argparse.ArgumentTypeError(f"{word} is no number of processes: give 1 or more")
    return int(word)


def _share(word: str) -> tuple[int, int]:
    """K of K/N, and N."""
    first, _, among = word.partition("/")
    if not (first.isdecimal() and among.isdecimal() and int(first) < int(among)):
        raise argparse.ArgumentTypeError(f"{word} is no share: give K/N with K from 0 to N - 1")
    return int(first), int(among)


def _worker(file: SweepFile, folder: Path, share: tuple[int, int]) -> int:
    """One process: its share of what is missing. It ends with the process that started it."""
    manifest, parent = begun(folder, file.digest) or read_manifest(folder), os.getppid()
    # Found anew elsewhere, the order might differ in rounding: variants would be lost, others be there twice.
    order = np.arange(manifest.count) if manifest.order is None else np.array(manifest.order)
    made = prepared(file, manifest.engine, manifest.width, order)
    for _ in work(made, folder, manifest, missing(folder, manifest)[share[0] :: share[1]]):
        if os.getppid() != parent:
            return INTERRUPTED
    return 0


def _watched(source: str, folder: Path, manifest: Manifest, processes: int) -> str:
    """Start the processes and wait for them; what went wrong, in words, or nothing."""
    environ = one_thread()
    modules = [word for index, word in enumerate(sys.argv) if _imports(sys.argv, index)]
    there = manifest.shards - len(missing(folder, manifest))
    started = []
    with Progress(manifest.shards, "shard", done=there) as bar:
        try:
            for number in range(processes):
                words = [sys.executable, "-m", "jaxfem", *modules, "sweep", source, "--out", str(folder)]
                log = (folder / f"worker_{number}.log").open("w", encoding="utf-8")
                share = ["--worker", f"{number}/{processes}"]
                started.append(subprocess.Popen([*words, *share], env=environ, stdout=log, stderr=log))
                log.close()
            bar.compiling()
            while any(process.poll() is None for process in started):
                time.sleep(LOOK)
                now = manifest.shards - len(missing(folder, manifest))
                if now > there:
                    bar.advance(now - there)
                    there = now
        finally:
            for process in started:
                if process.poll() is None:
                    process.terminate()
            for process in started:
                process.wait()
    failed = [number for number, process in enumerate(started) if process.returncode]
    if not failed:
        return ""
    said = (folder / f"worker_{failed[0]}.log").read_text(encoding="utf-8").strip().splitlines()
    return f"process {failed[0]} of {processes} ended: {said[-1] if said else started[failed[0]].returncode}"


def one_thread() -> dict[str, str]:
    """The environment of a process that leaves the other cores to others."""
    flags = os.environ.get("XLA_FLAGS", "")
    flags = flags if ONE_THREAD in flags else f"{flags} {ONE_THREAD}".strip()
    return {**os.environ, "XLA_FLAGS": flags, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _imports(words: list[str], index: int) -> bool:
    """Whether a word of the command line belongs to `--import`."""
    return words[index].startswith("--import") or (index > 0 and words[index - 1] == "--import")


def _shown(folder: Path, manifest: Manifest) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Outputs of one number by name (V,), and the statuses (V,)."""
    parts, status = [], []
    for number in range(manifest.shards):
        outputs, told, _ = read_shard(folder, manifest, number)
        parts.append(columns(outputs))
        status.append(told["status"])
    back = np.argsort(np.concatenate([manifest.members(number) for number in range(manifest.shards)]))
    shown = {name: np.concatenate([part[name] for part in parts])[back] for name in parts[0]}
    return shown, np.concatenate(status)[back]


def _indices(file: SweepFile, folder: Path, manifest: Manifest) -> list[Path]:
    """indices.csv; without it where an output does not vary or a variant failed."""
    shown, status = _shown(folder, manifest)
    try:
        return [write_indices(folder / "indices.csv", sensitivity_indices(file.variants, shown, status, file.seed))]
    except SweepError as problem:
        warning(f"{problem}; going on without indices")
        return []


def _plots(file: SweepFile, folder: Path, manifest: Manifest) -> list[Path]:
    """Response curves and pairs, of what a table shows."""
    shown, status = _shown(folder, manifest)
    good, values = status == 0, columns(file.variants)
    if not shown or not good.any():
        return []
    try:
        made = [plot_responses(folder / "responses.png", values, shown, good)]
        if len(values) > 1:
            name = next(iter(shown))
            made.append(plot_pairs(folder / "pairs.png", values, name, shown[name], good))
        return made
    except PlotError as problem:
        warning(f"{problem}; going on without them")
        return []


def _summary(
    file: SweepFile, manifest: Manifest, merged: Merged, todo: int, wall: float, processes: int, folder: Path
) -> str:
    told = "; ".join(f"{count}: {word}" for word, count in merged.statuses.items())
    names = ", ".join(path.relative_to(folder).as_posix() for path in merged.files)
    if merged.makers > 1:
        warning(f"{merged.makers} kinds of versions, flags or processors made the shards; each of them says which")
    return (
        f'engine "{manifest.engine}": {manifest.reason}\n'
        f"{file.source.name}: {manifest.count} variants in {manifest.shards} shards of {manifest.width}, {todo} of "
        f"them computed now by {processes} process{'es' if processes > 1 else ''} in {wall:.1f} s\n{told}\n"
        f"wrote {names} in {folder}"
    )
