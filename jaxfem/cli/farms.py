"""A sweep file's shards over many machines: the worker of `jaxfem sweep` under submitit (SLURM), Dask, Ray, or any
executor of `concurrent.futures`. The folder must be one that all machines see; which of them does what does not matter.

    begin("sweep.toml")                                    # checks everything, writes the manifest
    with_submitit(executor, "sweep.toml", jobs=50)         # or with_dask, with_ray, with_executor
    jaxfem sweep sweep.toml                                # what is missing, if any; then merges
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

from jaxfem.cli.sweep import one_thread
from jaxfem.io.sweep_files import load_sweep
from jaxfem.sweeping.shards import Manifest, missing, read_manifest


def begin(source: Any, out: Any = None, fresh: bool = False) -> Manifest:
    """Check a sweep file and write its manifest; `out`: where results go, instead of [output] folder; `fresh`: in place
    of an earlier sweep's. RuntimeError with what is wrong."""
    _run(source, out, "--begin", *(["--force"] if fresh else []))
    return read_manifest(Path(out or load_sweep(source).folder))


def share(source: str, out: str | None, job: int, jobs: int) -> int:
    """One job: every `jobs`-th missing shard from number `job` on, in a process of its own of one thread.

    RuntimeError with the process's last words where it fails.
    """
    _run(source, out, "--worker", f"{job}/{jobs}")
    return job


def _run(source: Any, out: Any, *options: str) -> None:
    """The command itself, so that flags and precision are those of its process."""
    folder = [] if out is None else ["--out", str(out)]
    words = [sys.executable, "-m", "jaxfem", "sweep", str(source), *folder, *options]
    done = subprocess.run(words, env=one_thread(), capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"jaxfem sweep {source}: {(done.stderr or 'no word').strip().splitlines()[-1]}")


def with_executor(executor: Any, source: str, jobs: int, out: str | None = None) -> None:
    """Through an executor of `concurrent.futures`, or one that has its `submit`, such as mpi4py's."""
    for each in [executor.submit(share, source, out, job, jobs) for job in range(jobs)]:
        each.result()


def with_submitit(executor: Any, source: str, jobs: int, out: str | None = None) -> None:
    """Through a submitit executor: on SLURM one array of jobs."""
    shared: list[Any] = [[source] * jobs, [out] * jobs, list(range(jobs)), [jobs] * jobs]
    for each in executor.map_array(share, *shared):
        each.result()


def with_dask(client: Any, source: str, jobs: int, out: str | None = None) -> None:
    """Through a client of `dask.distributed`."""
    client.gather([client.submit(share, source, out, job, jobs, pure=False) for job in range(jobs)])


def with_ray(ray: Any, source: str, jobs: int, out: str | None = None) -> None:
    """Through the module `ray`, once it is initialised."""
    remote = ray.remote(share)
    ray.get([remote.remote(source, out, job, jobs) for job in range(jobs)])


def left(source: Any, out: Any, manifest: Manifest) -> int:
    """How many shards are still missing."""
    return len(missing(Path(out or load_sweep(source).folder), manifest))
