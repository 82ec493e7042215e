"""Qualisys Track Manager's TSV export: a row a key, names of markers, then samples with or without a heading."""

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.base import Format, Request
from jaxfem.fitting.formats.content import Content, blank, number, rate_of, table
from jaxfem.fitting.recording import Recording

KEYS = ("NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "FREQUENCY", "DATA_INCLUDED", "MARKER_NAMES")


class Qualisys(Format, word="qualisys"):
    """A sample 0 0 0 is a lost one. Places are in mm unless asked otherwise."""

    title = "Qualisys TSV"

    @classmethod
    def claims(cls, content: Content) -> bool:
        """It begins with one of its keys."""
        return not content.binary and content.first.split("\t")[0].split(" ")[0] in KEYS

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """Columns Frame and Time come first where there is a heading."""
        where = cls.where(content.path)
        rows = content.rows("\t")
        keys = {row[0]: row[1:] for row in rows if row and row[0].isupper()}
        if "MARKER_NAMES" not in keys:
            kind = (keys.get("DATA_INCLUDED") or ["?"])[0]
            raise FitError(f"{where} names no markers (DATA_INCLUDED {kind}): export 3D data, not 6D or analog")
        names = [name for name in keys["MARKER_NAMES"] if name]
        first = next((k for k, row in enumerate(rows) if not blank(row) and _numeric(row)), len(rows))
        data = [(k + 1, rows[k]) for k in range(first, len(rows)) if not blank(rows[k])]
        if len(data) < 2:
            raise FitError(f"{where} holds {len(data)} rows of samples; a motion needs at least two")
        heading = [cell.lower() for cell in rows[first - 1]] if first else []
        lead = sum(word in heading[:2] for word in ("frame", "time"))
        width = max(len(row) for _, row in data) if not heading[:1] == ["frame"] else lead + 3 * len(names)
        if width not in (lead + 3 * len(names), lead + 3 * len(names) + 1):  # a tab may end each row
            raise FitError(
                f"{where}: {width} columns do not make x, y, z of {len(names)} markers: export 3D data alone, not 6D"
            )
        places = [(lead + k, f"{names[k // 3]} {'XYZ'[k % 3]}") for k in range(3 * len(names))]
        values = table(where, data, places, True).reshape(len(data), -1, 3)
        scale, unit = cls.scale(content, asked, "mm", "")
        lost = (values == 0).all(axis=-1)
        notes = cls.counted((keys.get("NO_OF_FRAMES") or [""])[0], len(data))
        notes += [f"{int(lost.sum())} samples 0 0 0 are lost ones"] if lost.any() else []
        rate = rate_of((keys.get("FREQUENCY") or [""])[0])
        times = cls.times(content, np.arange(len(data), dtype=float), rate, asked, "give rate=")
        if lead == 2 and asked.rate is None:
            times = table(where, data, [(1, "Time")], True)[:, 0]
        return cls.made(content, times, scale * np.where(lost[..., None], np.nan, values), names, unit, notes)


def _numeric(row: list[str]) -> bool:
    try:
        return bool([number(cell, True) for cell in row]) and not row[0].isupper()
    except ValueError:
        return False
