"""Compiled programs of the tests: kept on disk from run to run, and forgotten where memory runs short.

They are compiled for a short compilation, not for speed: nearly all of the tests' time is compiling.
JAXFEM_TEST_CACHE names another folder for them, or is `off`. A JAX_COMPILATION_CACHE_DIR that is already set is used
as it is. Workers, the notebooks' kernels and the command line's processes find the folder through the environment.
"""

import ctypes
import gc
import os
import pathlib
import resource
import sys
from collections.abc import MutableMapping

import jax

from jaxfem.cli.programs import OFF, trim
from jaxfem.cli.threads import one_blas_thread
from jaxfem.cli.xla_flags import NO_OPTIMISATION, OLDER_EMITTER, ask_for

LARGEST = 4 << 30  # bytes on disk; a run of all tests leaves well under one of them
MOST_MEMORY = 8e9  # bytes a process
# Together a quarter of the time that the defaults take; the programs are slower, which small scenes hardly show.
# Parts that threads compile at once take a fifth more of all processors' time, and each has a worker of its own.
QUICK_COMPILE = NO_OPTIMISATION, OLDER_EMITTER, "--xla_cpu_parallel_codegen_split_count=1"


def compile_quickly(environment: MutableMapping[str, str] = os.environ) -> None:
    """Have XLA compile quickly, here and in processes that are started from here, unless XLA_FLAGS says how."""
    ask_for(*QUICK_COMPILE, environment=environment)
    one_blas_thread(environment)  # workers have no core to spare for threads that wait


def keep(folder: pathlib.Path | None, first: bool) -> None:
    """Have JAX keep programs in `folder`; the `first` process of a run clears out old ones."""
    wanted = os.environ.get("JAXFEM_TEST_CACHE", "")
    if wanted.lower() in OFF:
        jax.config.update("jax_enable_compilation_cache", False)
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "0"
        return
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = pathlib.Path(wanted).absolute() if wanted else folder
        if folder is None:
            return
        if first:
            folder.mkdir(parents=True, exist_ok=True)
            trim(folder, LARGEST)
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"  # thousands of small programs take minutes
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_compilation_cache_dir", str(folder))


def forget() -> None:
    """Drop the programs in memory, and what memory they leave: where none goes back to the system, a worker that once
    was too large would forget all of them after each file, and trace and load them anew for the next."""
    jax.clear_caches()
    gc.collect()
    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    except (OSError, AttributeError):  # not glibc
        pass


def memory() -> float:
    """Bytes that this process holds in memory; where the system does not tell, the most that it has held."""
    try:
        pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else 1024 * peak


def most_memory() -> float:
    """Bytes that a worker may hold: half the machine's memory is for all of them."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    return min(MOST_MEMORY, 0.5 * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / workers)
