"""What is in a file, before anybody knows its format: bytes, text in whatever encoding, rows of cells, numbers."""

import codecs
import csv
import dataclasses
import functools
import pathlib
import re

import numpy as np

from jaxfem.fitting.errors import FitError

ENCODINGS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # before UTF-16, whose mark it begins with
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
MISSING = frozenset(
    ("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "missing", "1.#qnan", "-nan", "-1.#ind")
)
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
OTHERS = (
    (b"\x89HDF", "an HDF5 file (DeepLabCut's .h5, say)", "export it as CSV"),
    (b"PK\x03\x04", "a workbook or a zip file", "save its sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", "save its sheet as CSV"),
    (b"MATLAB", "a MATLAB file", "export the samples as CSV, TSV or C3D"),
)


@dataclasses.dataclass(frozen=True)
class Content:
    """A file's `path` and `data`; its text and lines when they are asked for."""

    path: pathlib.Path
    data: bytes

    @functools.cached_property
    def binary(self) -> bool:
        """Whether it is no text."""
        return any(c < " " and c not in "\t\n\f\x1a" for c in self.text[:4096])

    @functools.cached_property
    def encoding(self) -> str:
        """By its mark, by the zeros between Latin letters, else UTF-8 where that is valid and Latin-1 where not."""
        for mark, name in ENCODINGS:
            if self.data.startswith(mark):
                return name
        start = self.data[:512]
        if len(start) > 8 and start[1::2].count(0) > 0.8 * (len(start) // 2):
            return "utf-16-le"
        if len(start) > 8 and start[0::2].count(0) > 0.8 * (len(start) // 2):
            return "utf-16-be"
        try:
            self.data.decode("utf-8")
        except UnicodeDecodeError:
            return "latin-1"
        return "utf-8"

    @functools.cached_property
    def text(self) -> str:
        """The text, with plain line ends."""
        return self.data.decode(self.encoding).replace("\r\n", "\n").replace("\r", "\n")

    @functools.cached_property
    def lines(self) -> list[str]:
        """Lines, blank ones too: number k stands in line k + 1."""
        return self.text.split("\n")

    @functools.cached_property
    def first(self) -> str:
        """The first line that is not blank."""
        return next((line.strip() for line in self.lines if line.strip(' \t,;"')), "")

    def rows(self, separator: str) -> list[list[str]]:
        """Cells of each line, stripped; a blank line gives cells that are all empty, or none."""
        if separator == " ":
            return [line.split() for line in self.lines]
        return [[cell.strip() for cell in _split(line, separator)] for line in self.lines]


def load(path: pathlib.Path) -> Content:
    """Read a file; FitError where it cannot be read, is empty or is of a kind that is known to be something else."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FitError(f"cannot read the recording {path}: {error.strerror}") from error
    if not data.strip():
        raise FitError(f"{path} is empty: its first row must name the columns time_s, NAME_x_m, NAME_y_m, NAME_z_m")
    for start, what, cure in OTHERS:
        if data.startswith(start):
            raise FitError(f"{path} is {what}: {cure}")
    return Content(path, data)


def separator_of(lines: list[str]) -> str:
    """What parts the cells of these lines: the one of ; tab | , that gives most columns to the first of them.

    A semicolon or tab outdoes commas, which may be decimal; blanks where there is none of them.
    """
    line = next((line for line in lines if line.strip()), "")
    counts = {each: len(_split(line, each)) for each in (";", "\t", "|", ",")}
    for each in (";", "\t", "|"):
        if counts[each] > 1:
            return each
    return "," if counts[","] > 1 or len(line.split()) < 2 else " "


def number(text: str, comma: bool = False) -> float:
    """A cell's number, NaN where it says that there is none; ValueError for other text. `comma`: a decimal comma is
    admissible."""
    if text.lower() in MISSING:
        return float("nan")
    if comma and DECIMAL_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    text = text.replace("\N{MINUS SIGN}", "-")
    if "_" in text:  # Python's own grouping of digits is nobody's number format
        raise ValueError(text)
    return float(text)


def table(where: str, rows: list[tuple[int, list[str]]], columns: list[tuple[int, str]], comma: bool) -> np.ndarray:
    """Numbers (R, C) of numbered rows at `columns` (place, name); cells that a row lacks are missing. FitError, with
    line and column, for what is no number. `where` begins the message."""
    values = np.full((len(rows), len(columns)), np.nan)
    for r, (line, cells) in enumerate(rows):
        for c, (place, name) in enumerate(columns):
            if place < len(cells):
                try:
                    values[r, c] = number(cells[place], comma)
                except ValueError:
                    clock = ":" in cells[place]
                    cure = "give times in s, as numbers" if clock else "leave missing samples blank"
                    raise FitError(
                        f'{where}, line {line}, column "{name}": {cells[place]!r} is not a number; {cure}'
                    ) from None
    return values


def blank(cells: list[str]) -> bool:
    """Whether a row says nothing."""
    return not any(cells)


def _split(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator), [])
