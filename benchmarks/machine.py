"""What a benchmark says of the machine and of its measuring: words for the CPU, medians after warm-up."""

import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax


def describe() -> str:
    """The machine in words, without names or paths of its own."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = f"{names[0]}, {len(names)} cores" if names else model
    return f"{model}; Python {platform.python_version()}, JAX {jax.__version__}, {jax.default_backend()}"


def median_time(call: Callable[[], Any], repeats: int = 5) -> float:
    """Median wall time [s] of `call` after one call to compile and warm up; waits for its arrays."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def first_time(call: Callable[[], Any]) -> float:
    """Wall time [s] of the first call, compilation included."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start
