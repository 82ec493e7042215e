"""A progress bar on a terminal; nothing where the output goes to a file."""

import sys
import time
from typing import Any


class Progress:
    """Counts up to `total` of `unit` on standard error; a context manager. Quiet unless that is a terminal.

    Shown through tqdm, or as a plain line of percents where tqdm is not installed. `done`: how many were before. The
    time left is told by the counts since the last one that was `compiled`, whose time says nothing of the others.
    """

    def __init__(self, total: int, unit: str = "step", shown: bool | None = None, done: int = 0):
        self.total, self.unit, self.done = total, unit, done
        self.shown = sys.stderr.isatty() if shown is None else shown
        self.bar: Any = None

    def __enter__(self) -> "Progress":
        if self.shown:
            try:
                from tqdm import tqdm
            except ImportError:
                return self
            words = {"unit": f" {self.unit}", "initial": self.done, "smoothing": 0, "dynamic_ncols": True}
            self.bar = tqdm(total=self.total, file=sys.stderr, leave=False, **words)
        return self

    def __exit__(self, *problem: Any) -> None:
        if self.bar is not None:
            self.bar.close()
        elif self.shown:
            print(file=sys.stderr)

    def compiling(self) -> None:
        """Say so, until the next count."""
        if self.bar is not None:
            self.bar.set_description("compiling")
        elif self.shown:
            print("\rcompiling ", end="", file=sys.stderr, flush=True)

    def advance(self, count: int, note: str = "", compiled: bool = False) -> None:
        """Count on, with a short note beside the bar; `compiled`: most of the time went into compiling."""
        self.done += count
        if self.bar is not None:
            self.bar.set_description("", refresh=False)
            self.bar.set_postfix_str(note, refresh=False)
            self.bar.update(count)
            if compiled:  # what comes is measured from here
                self.bar.initial, self.bar.start_t = self.done, time.time()
        elif self.shown:
            share = 100 * self.done // self.total
            print(
                f"\r{share:3d} %  {self.unit} {self.done} of {self.total}  {note} ", end="", file=sys.stderr, flush=True
            )

    def clear(self) -> None:
        """Make room for a line of text; the bar comes back below it."""
        if self.bar is not None:
            self.bar.clear()
        elif self.shown:
            print(file=sys.stderr)
