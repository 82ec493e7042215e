"""A progress bar on a terminal; nothing where the output goes to a file."""

import sys
from typing import Any


class Progress:
    """Counts up to `total` of `unit` on standard error; a context manager. Quiet unless that is a terminal.

    Shown through tqdm, or as a plain line of percents where tqdm is not installed.
    """

    def __init__(self, total: int, unit: str = "step", shown: bool | None = None):
        self.total, self.unit, self.done = total, unit, 0
        self.shown = sys.stderr.isatty() if shown is None else shown
        self.bar: Any = None

    def __enter__(self) -> "Progress":
        if self.shown:
            try:
                from tqdm import tqdm
            except ImportError:
                return self
            self.bar = tqdm(total=self.total, unit=f" {self.unit}", file=sys.stderr, dynamic_ncols=True, leave=False)
        return self

    def __exit__(self, *problem: Any) -> None:
        if self.bar is not None:
            self.bar.close()
        elif self.shown:
            print(file=sys.stderr)

    def advance(self, count: int, note: str = "") -> None:
        """Count on, with a short note beside the bar."""
        self.done += count
        if self.bar is not None:
            self.bar.set_postfix_str(note, refresh=False)
            self.bar.update(count)
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
