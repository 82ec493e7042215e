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
THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:[ \N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}'.,]\d{3})+(?:[.,]\d*)?")
OTHERS = (
    (b"\x89HDF", "an HDF5 file (DeepLabCut's .h5, say)", "export it as CSV"),
    (b"PK\x03\x04", "a workbook or a zip file", "save its sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", "save its sheet as CSV"),
    (b"MATLAB", "a MATLAB file", "export the samples as CSV, TSV or C3D"),
    (b"\x93NUMPY", "an array of NumPy", "give it to Recording(times, positions, names)"),
    (b"\x1f\x8b", "a compressed file (gzip)", "unpack it"),
    (b"version https://git-lfs", "a pointer of Git LFS and not the file itself", "fetch that (git lfs pull)"),
    (b"<", "a page of the web, or XML", "see what was downloaded, and export the samples as CSV, TSV or C3D"),
    (b"{", "JSON", "export the samples as CSV, TSV or C3D"),
    (b"%PDF", "a PDF document", "export the samples as CSV, TSV or C3D"),
    (b"\x89PNG", "a picture", "export the samples as CSV, TSV or C3D"),
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
        zeros = [start[k::2].count(0) / (len(start) // 2 or 1) for k in (0, 1)]  # binary files have both
        if len(start) > 8 and zeros[1] > 0.8 and zeros[0] < 0.2:
            return "utf-16-le"
        if len(start) > 8 and zeros[0] > 0.8 and zeros[1] < 0.2:
            return "utf-16-be"
        try:
            self.data.decode("utf-8")
        except UnicodeDecodeError:
            return "latin-1"
        return "utf-8"

    @functools.cached_property
    def text(self) -> str:
        """The text, with plain line ends; FitError where bytes are not of its encoding."""
        try:
            text = self.data.decode(self.encoding)
        except UnicodeDecodeError as flaw:
            raise FitError(
                f"{self.path} begins as text in {self.encoding.upper()} and does not go on so, from byte {flaw.start} "
                "on: it was cut off, or put together of parts in several encodings. Save it again as UTF-8"
            ) from flaw
        return text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a")  # the end of a text under DOS

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


def rate_of(text: str) -> float:
    """A rate as a file states it, NaN where it states none."""
    try:
        return number(text, True)
    except ValueError:
        return float("nan")


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
                    raise FitError(
                        f'{where}, line {line}, column "{name}": {cells[place]!r} is not a number; '
                        f"{_cure(cells[place], cells)}"
                    ) from None
    if comma:
        _check_commas(where, rows, columns)
    return values


def _cure(cell: str, cells: list[str]) -> str:
    """What to do about a cell that is no number."""
    if ":" in cell:
        return "give times in s, as numbers"
    if THOUSANDS.fullmatch(cell):
        return "write numbers without separators of thousands"
    if DECIMAL_COMMA.fullmatch(cell):
        return "a decimal comma needs another separator, a semicolon say"
    if not any(map(_is_number, cells)):
        return "take that row out, and give units by the names of columns (NAME_x_mm)"
    return "leave missing samples blank"


def _is_number(cell: str) -> bool:
    try:
        return bool(np.isfinite(number(cell, True)))
    except ValueError:
        return False


def _check_commas(where: str, rows: list[tuple[int, list[str]]], columns: list[tuple[int, str]]) -> None:
    """FitError where some cells have a decimal comma and others a point: one of them parts thousands."""
    seen: dict[str, str] = {}
    for line, cells in rows:
        for place, name in columns:
            cell = cells[place] if place < len(cells) else ""
            for mark in ",.":
                if mark in cell:
                    seen.setdefault(mark, f'{cell!r} in line {line}, column "{name}"')
    if len(seen) > 1:
        raise FitError(
            f"{where}: {seen[',']}, has a comma, and {seen['.']}, a point: one of them parts thousands, or decimals "
            "are written in two ways. Export with one mark of decimals and none of thousands"
        )


def blank(cells: list[str]) -> bool:
    """Whether a row says nothing."""
    return not any(cells)


def _split(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator), [])
