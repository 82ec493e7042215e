"""Plain tables: a row of column names, time_s and NAME_x_m, NAME_y_m, NAME_z_m, in any common dialect of CSV."""

import re
from collections.abc import Sequence

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats import units
from jaxfem.fitting.formats.base import Format, Request, clipped
from jaxfem.fitting.formats.content import DECIMAL_COMMA, Content, blank, number, separator_of, table
from jaxfem.fitting.recording import AXES, Recording

UNIT = r"(?:[ _]*[\[(]?(?P<unit>[A-Za-zµμ]+)[\])]?)?"
TIME = re.compile(rf"(?:time|times|timestamp|t|zeit){UNIT}", re.IGNORECASE)
PLACE = re.compile(rf"(?P<name>.+?)[ _.:]+(?P<axis>[XYZxyz]){UNIT}")
COUNTERS = ("", "frame", "frames", "frame#", "frame_number", "fnum", "index", "row", "sample", "unnamed: 0", "#", "nr")
SAME = 0.05  # by which a rate that is given may differ from that of the times beside it
SHAPE = "columns time_s, NAME_x_m, NAME_y_m, NAME_z_m"


class Plain(Format, word="plain"):
    """Any separator, decimal comma and encoding; units by suffix (_m, _mm, _ms, ...); columns in any order."""

    title = "plain table"
    fallback = True

    @classmethod
    def claims(cls, content: Content) -> bool:
        """Any text."""
        return not content.binary

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """Columns other than time, places and counters of rows are refused."""
        lines = _marked_off(content.lines)
        separator = separator_of([line for _, line in lines])
        split = dict(enumerate(content.rows(separator), 1))
        rows = [(line, split[line]) for line, _ in lines if not blank(split[line])]
        if not rows:
            raise FitError(f"{content.path} is empty: its first row must name the {SHAPE}")
        header = _header(rows[0][1], rows[1:])
        comma = separator != ","
        where = str(content.path)
        times, names, notes = cls._roles(content, header, asked)
        if len(rows) < 3:
            raise FitError(f"{content.path} holds {len(rows) - 1} rows of samples; a motion needs at least two")
        _check_widths(where, header, rows[1:], separator)
        used = [times, *(column for name in names for column in names[name])]
        values = table(where, rows[1:], [(place, header[place]) for place, _, _ in used], comma)
        values *= [scale for _, scale, _ in used]
        clock, told = cls._clock(where, header[times[0]], values[:, 0], asked)
        notes += told
        signs = sorted({sign for _, _, sign in used[1:]})
        if separator != "," and any(DECIMAL_COMMA.fullmatch(cell) for _, row in rows[1:] for cell in row):
            notes.append("decimal commas")
        if content.encoding not in ("utf-8", "utf-8-sig"):
            notes.append(f"encoding {content.encoding}")
        return cls.made(content, clock, values[:, 1:].reshape(len(values), -1, 3), list(names), ", ".join(signs), notes)

    @classmethod
    def _clock(cls, where: str, column: str, values: np.ndarray, asked: Request) -> tuple[np.ndarray, list[str]]:
        """Times [s] of the column of the clock, with notes; a rate that is asked for tells what its numbers are."""
        if column.lower() in COUNTERS:
            return values - values[0], []
        usual = float(np.median(np.diff(values))) if np.isfinite(values).all() else np.nan
        if asked.rate is None or not usual > 0 or abs(usual * asked.rate - 1) < SAME:
            return values, []
        if usual >= 1 and np.array_equal(values, np.round(values)):
            return (values - values[0]) / asked.rate, [f'column "{column}" holds frame numbers, taken over the rate']
        raise FitError(
            f'{where}: rate = {asked.rate:g} is given, and the times in column "{column}" say {1 / usual:.4g} rows a '
            "second: leave one of them out, or correct it"
        )

    @classmethod
    def where(cls, path: object) -> str:
        """The path alone: it is the format that needs no name."""
        return str(path)

    @classmethod
    def _roles(
        cls, content: Content, header: Sequence[str], asked: Request
    ) -> tuple[tuple[int, float, str], dict[str, list[tuple[int, float, str]]], list[str]]:
        """(place, scale, unit) of the time, and of x, y, z of each marker; notes."""
        path, time, places, counters = content.path, None, dict[str, dict[str, tuple[int, float, str]]](), list[int]()
        overruled = dict[str, None]()
        if all(_is_number(column) for column in header):
            raise FitError(f"{path} begins with numbers: its first row must name the {SHAPE}")
        repeated = [column for column in header if column and header.count(column) > 1]
        if repeated:
            raise FitError(f'{path}: column "{repeated[0]}" is there twice')
        for k, column in enumerate(header):
            if column.lower() in COUNTERS:
                counters.append(k)
            elif (found := TIME.fullmatch(column)) and units.short(found["unit"] or "s") in units.TIMES:
                if time is not None:
                    raise FitError(f'{path}: columns "{header[time[0]]}" and "{column}" are both times: keep one')
                sign = units.short(found["unit"] or "s")
                time = (k, units.TIMES[sign], sign)
            elif found := PLACE.fullmatch(column):
                sign = asked.unit or found["unit"] or ""
                overruled |= dict.fromkeys(cls.overruled(asked, found["unit"] or ""))
                places.setdefault(found["name"], {})[found["axis"].lower()] = (k, _metres(path, column, sign), sign)
            else:
                first = "the first row names columns, and " if k == 0 else ""
                raise FitError(
                    f'{path}: {first}column "{column}" is not one of time_s, NAME_x_m, NAME_y_m, NAME_z_m (units: '
                    f"{clipped(list(units.LENGTHS), 4)}); take it out, or rename it"
                )
        notes = [f'column "{header[k]}", a counter of rows, is left out' for k in counters if header[k]]
        notes += [f"column {k + 1}, which has no name, is left out" for k in counters if k and not header[k]]
        notes += overruled
        if time is None:
            time, notes = (
                _by_frames(path, header, counters, asked),
                ["times are frame numbers over the rate", *overruled],
            )
        for name, axes in places.items():
            missing = [f"{name}_{axis}_m" for axis in AXES if axis not in axes]
            if missing:
                raise FitError(f'{path}: marker "{name}" lacks the column {", ".join(missing)}')
        if not places:
            raise FitError(f"{path} holds no marker: give at least one, as columns NAME_x_m, NAME_y_m, NAME_z_m")
        return time, {name: [axes[axis] for axis in AXES] for name, axes in places.items()}, notes


def _is_number(cell: str) -> bool:
    try:
        number(cell, True)
        return True
    except ValueError:
        return False


def _by_frames(path: object, header: Sequence[str], counters: list[int], asked: Request) -> tuple[int, float, str]:
    if asked.rate is not None and asked.rate > 0 and counters:
        return counters[0], 1.0 / asked.rate, "frames"
    raise FitError(
        f'{path} has no column "time_s" (seconds); its columns: {", ".join(header)}. Where one counts frames, '
        "give their rate: rate=100"
    )


def _metres(path: object, column: str, sign: str) -> float:
    if not sign:
        raise FitError(f'{path}: column "{column}" says no unit: call it {column}_m or {column}_mm, or give unit="mm"')
    return units.length(sign, f'{path}: column "{column}"')


def _marked_off(lines: list[str]) -> list[tuple[int, str]]:
    """Numbered lines that are neither comments nor Excel's "sep=;", blank ones left out; a header may be a comment."""
    kept = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.lower().startswith("sep=")]
    return [(k, line) for k, line in kept if not line.startswith("#")]


def _header(cells: list[str], rows: list[tuple[int, list[str]]]) -> list[str]:
    """Column names, without empty ones at the end below which nothing stands (a trailing separator)."""
    header = [cell.strip() for cell in cells]
    while header and not header[-1] and not any(len(row) >= len(header) and row[len(header) - 1] for _, row in rows):
        header.pop()
    return header


def _check_widths(where: str, header: list[str], rows: list[tuple[int, list[str]]], separator: str) -> None:
    for line, row in rows:
        if len(row) < len(header) or any(row[len(header) :]):
            hint = "; a decimal comma needs another separator, a semicolon say" if separator == "," else ""
            raise FitError(
                f"{where}, line {line}: {len(row)} cells where the first row names {len(header)} columns{hint}"
            )
