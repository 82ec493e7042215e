"""How far long work is: on a terminal a bar, or a line that is written over; in a file a line now and then."""

import sys
import time
from typing import Any

EVERY = 10.0  # s between lines in a file


class Pace:
    """Whether it is time for a line in a file."""

    def __init__(self) -> None:
        self.told = time.monotonic()

    def due(self) -> bool:
        """True once in `EVERY` seconds."""
        now = time.monotonic()
        if now - self.told < EVERY:
            return False
        self.told = now
        return True


class Progress:
    """Counts up to `total` of `unit` on standard error; a context manager. Where that is a file: a line now and then.

    Shown through tqdm, or as a plain line of percents where tqdm is not installed. `done`: how many were before. The
    time left is told by the counts since the last one that was `compiled`, whose time says nothing of the others.
    """

    def __init__(self, total: int, unit: str = "step", shown: bool | None = None, done: int = 0):
        self.total, self.unit, self.done = total, unit, done
        self.shown = sys.stderr.isatty() if shown is None else shown
        self.bar: Any = None
        self.pace = Pace()

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
        elif self.shown or self.pace.due():
            share = 100 * self.done // max(self.total, 1)
            line = f"{share:3d} %  {self.unit} {self.done} of {self.total}  {note} "
            print(f"\r{line}" if self.shown else line, end="" if self.shown else "\n", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Make room for a line of text; the bar comes back below it."""
        if self.bar is not None:
            self.bar.clear()
        elif self.shown:
            print(file=sys.stderr)


class Ticker:
    """A line that tells how far a fit, or what follows it, is; a context manager."""

    def __init__(self, begin: str = "") -> None:
        """`begin`: what begins, told in a file at once."""
        self.shown, self.best = sys.stderr.isatty(), float("inf")
        self.begin, self.pace = begin, Pace()

    def __enter__(self) -> "Ticker":
        if self.shown:
            print(f"{self.begin or 'compiling'} ...", end="", file=sys.stderr, flush=True)
        elif self.begin:
            print(f"{self.begin} ...", file=sys.stderr, flush=True)
        return self

    def __exit__(self, *problem: Any) -> None:
        if self.shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def show(self, stage: str, iteration: int, loss: float, values: dict[str, float]) -> None:
        """Stage, count of simulations, best loss, the values tried."""
        self.best = min(self.best, loss)
        listed = "  ".join(f"{name} {value:.4g}" for name, value in values.items())
        self.line(f"{stage:<10} simulation {iteration + 1:3d}  best loss {self.best:.3g}  {listed}")

    def count(self, what: str, done: int, total: int) -> None:
        """So many of a total."""
        self.line(f"{what} {done} of {total}")

    def line(self, text: str) -> None:
        """Any line."""
        if self.shown:
            print(f"\r\x1b[K{text[:110]}", end="", file=sys.stderr, flush=True)
        elif self.pace.due():
            print(text, file=sys.stderr, flush=True)
