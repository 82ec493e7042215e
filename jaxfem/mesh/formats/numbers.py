"""Numbers of a section of a file, as text or binary, one after the other."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..checks import Floats, Ints, MeshError

SHORT = "numbers are missing: the file is cut short"


class Numbers:
    """Reads a section's `content` from its start; `width`: bytes of a long number, `swapped`: big-endian."""

    def __init__(self, content: bytes, binary: bool, swapped: bool = False, width: int = 8):
        self.content, self.binary, self.swapped, self.width = content, binary, swapped, width
        self.place = 0
        self._words: list[bytes] | None = None

    def _take(self, count: int, dtype: str) -> Any:
        kind = np.dtype((">" if self.swapped else "<") + dtype)
        if self.binary:
            start, self.place = self.place, self.place + count * kind.itemsize
            if self.place > len(self.content):
                raise MeshError(SHORT)
            return np.frombuffer(self.content, kind, count, start)
        if self._words is None:
            self._words = self.content.split()
        words = self._words[self.place : self.place + count]
        self.place += count
        if len(words) < count:
            raise MeshError(SHORT)
        return np.array(words, dtype=np.float64 if kind.kind == "f" else np.int64)

    def ints(self, count: int) -> Ints:
        """So many whole numbers of 4 bytes."""
        return np.asarray(self._take(count, "i4"), dtype=np.int64)

    def longs(self, count: int) -> Ints:
        """So many whole numbers of `width` bytes: counts and, in newer files, numbers of nodes and elements."""
        return np.asarray(self._take(count, f"u{self.width}"), dtype=np.int64)

    def floats(self, count: int) -> Floats:
        """So many numbers of 8 bytes."""
        return np.asarray(self._take(count, "f8"), dtype=np.float64)

    def count(self) -> int:
        """The number on the first line, which is text in binary files too."""
        line, found, _ = self.content.partition(b"\n")
        if not found or not line.strip().isdigit():
            raise MeshError(SHORT)
        if self.binary:
            self.place = len(line) + 1
        else:
            self.place = 1
        return int(line)

    def records(self, count: int, fields: list[Any]) -> Any:
        """So many binary records with the given fields (name, type, count)."""
        order = ">" if self.swapped else "<"
        kind = np.dtype([(name, order + own, *size) for name, own, *size in fields])
        start, self.place = self.place, self.place + count * kind.itemsize
        if self.place > len(self.content):
            raise MeshError(SHORT)
        return np.frombuffer(self.content, kind, count, start)

    def lines(self, count: int) -> Iterator[list[int]]:
        """The lines after the first, as whole numbers."""
        rows = [line for line in self.content.splitlines()[1:] if line.strip()]
        if len(rows) < count:
            raise MeshError(SHORT)
        for row in rows[:count]:
            yield [int(word) for word in row.split()]


def node_index(numbers: Any) -> Callable[[Any], Ints]:
    """A function that takes numbers of nodes, as the file counts them, to places in the list of points."""
    order = np.argsort(numbers, kind="stable")
    known = np.asarray(numbers)[order]

    def index(wanted: Any) -> Ints:
        place = np.minimum(np.searchsorted(known, wanted), max(len(known) - 1, 0))
        wrong = known[place] != wanted
        if wrong.any():
            raise MeshError(f"an element uses node {int(np.asarray(wanted)[wrong][0])}, which the file does not hold")
        return np.asarray(order[place], dtype=np.int64)

    return index
