"""Jobs of a benchmark over processes, where what counts is what comes out and not how long each takes."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any


def spread(job: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], processes: int) -> Iterator[tuple[int, Any]]:
    """(number, answer) of each job, as they end; with one process here and in order. `job`: a module's own function."""
    if processes == 1:
        yield from enumerate(job(*given) for given in jobs)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        numbers = {pool.submit(job, *given): number for number, given in enumerate(jobs)}
        for done in as_completed(numbers):
            yield numbers[done], done.result()
