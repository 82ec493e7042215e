"""Anipose's 3-D CSV (Karashchuk et al. 2021): NAME_x, _y, _z, _error, _ncams, _score, a frame M_00..M_22, fnum."""

import re

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.base import Format, Request, check_once
from jaxfem.fitting.formats.content import Content, blank, separator_of, table
from jaxfem.fitting.recording import Recording

FRAME = re.compile(r"M_[0-2][0-2]|center_[0-2]|fnum")
PART = re.compile(r"(.+)_(x|y|z)")


class Anipose(Format, word="anipose"):
    """Lengths are in the calibration board's unit, and only frames are numbered: unit and rate must be given."""

    title = "Anipose 3-D CSV"

    @classmethod
    def claims(cls, content: Content) -> bool:
        """Its first row names x and ncams or score of a part, and fnum."""
        if content.binary:
            return False
        cells = content.rows(separator_of([content.first]))[content.lines.index(next(filter(str.strip, content.lines)))]
        return "fnum" in cells and any(c.endswith(("_ncams", "_error")) for c in cells)

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """Places in the frame that the file's own M and center have already been taken to."""
        where = cls.where(content.path)
        separator = separator_of([content.first])
        rows = [(k, row) for k, row in enumerate(content.rows(separator), 1) if not blank(row)]
        header, data = rows[0][1], rows[1:]
        if len(data) < 2:
            raise FitError(f"{where} holds {len(data)} rows of samples; a motion needs at least two")
        for cell in header:
            check_once(where, cell, "", [each for each in header if each == cell][1:])
        parts = dict.fromkeys(m[1] for cell in header if not FRAME.fullmatch(cell) and (m := PART.fullmatch(cell)))
        for name in parts:
            missing = [f"{name}_{axis}" for axis in "xyz" if f"{name}_{axis}" not in header]
            if missing:
                raise FitError(f'{where}: marker "{name}" lacks the column {", ".join(missing)}')
        if not parts:
            raise FitError(f"{where} names no part with _x, _y, _z")
        scale, unit = cls.scale(content, asked, "", 'give the calibration board\'s, unit="mm" or --unit mm say')
        columns = [(header.index(f"{name}_{axis}"), f"{name}_{axis}") for name in parts for axis in "xyz"]
        values = table(where, data, [(header.index("fnum"), "fnum"), *columns], separator != ",")
        cure = "give the camera's, rate=100 or --rate 100 say"
        times = cls.times(content, values[:, 0], None, asked, cure)
        return cls.made(content, times, scale * values[:, 1:].reshape(len(data), -1, 3), list(parts), unit)
