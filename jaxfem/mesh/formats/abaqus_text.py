"""The text of Abaqus and CalculiX input files: keyword lines with their parameters and the lines of data below."""

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..checks import Ints, MeshError

DEEPEST = 16  # *INCLUDE in *INCLUDE


@dataclasses.dataclass
class Keyword:
    """A keyword in capitals, parameters (name in capitals -> value), lines of data, and the number of its own line."""

    word: str
    parameters: dict[str, str]
    lines: list[str]
    line: int

    def parameter(self, name: str) -> str:
        """A parameter's value, "" where there is none."""
        return self.parameters.get(name, "")

    def items(self) -> list[str]:
        """All entries of the data lines, empty ones left out."""
        return [entry for line in self.lines for entry in fields(line) if entry]


def keywords(path: Path, deep: int = 0) -> Iterator[Keyword]:
    """The keywords of a file, in order, and of those that it includes; comments (**) are left out."""
    if deep > DEEPEST:
        raise MeshError(f"{path} includes itself")
    current: Keyword | None = None
    head = ""
    for number, raw in enumerate(path.read_text(errors="replace").splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith("**"):
            continue
        if not line.startswith("*") and not head:
            if current is not None:
                current.lines.append(line)
            continue
        head += line
        if line.endswith(","):  # goes on in the next line
            continue
        if current is not None:
            yield from _followed(current, path, deep)
        current, head = _keyword(head, number), ""
    if current is not None:
        yield from _followed(current, path, deep)


def _followed(keyword: Keyword, path: Path, deep: int) -> Iterator[Keyword]:
    if keyword.word != "INCLUDE":
        yield keyword
        return
    target = path.parent / keyword.parameter("INPUT")
    if not target.is_file():
        raise MeshError(f"line {keyword.line} includes {target.name}, which is not beside it")
    yield from keywords(target, deep + 1)


def _keyword(head: str, number: int) -> Keyword:
    word, *rest = fields(head[1:])
    pairs = (each.partition("=") for each in rest if each)
    parameters = {name.strip().upper(): value.strip().strip('"') for name, _, value in pairs}
    return Keyword(" ".join(word.upper().split()), parameters, [], number)


def fields(line: str) -> list[str]:
    """Entries between commas, without blanks and quotation marks; commas within quotation marks separate nothing."""
    parts = line.split(",") if '"' not in line else re.findall(r'((?:"[^"]*"|[^,"])*)(?:,|$)', line)
    return [part.strip().strip('"') for part in parts]


def whole(items: list[str], keyword: Keyword) -> Ints:
    """Entries as whole numbers; MeshError with the keyword's line."""
    try:
        return np.array(items, dtype=np.int64)
    except ValueError as problem:
        raise MeshError(f"below *{keyword.word} in line {keyword.line}: {problem}") from problem
