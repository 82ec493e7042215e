"""OptiTrack Motive's CSV export, versions 1.2x: rows of Type, Name, ID above Frame, Time (Seconds), X, Y, Z."""

import csv

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.base import Format, Request, check_once, clipped, short_names
from jaxfem.fitting.formats.content import Content, blank, rate_of, separator_of, table
from jaxfem.fitting.recording import Recording

KINDS = ("marker", "rigid body", "rigid body marker", "bone", "bone marker", "skeleton", "trained markerset marker")
CURE = 'export with the header information, or give unit="mm"'


class Motive(Format, word="motive"):
    """Measured markers only: poses, solved ("Rigid Body Marker") ones and unlabelled fragments are left out."""

    title = "OptiTrack Motive CSV"

    @classmethod
    def claims(cls, content: Content) -> bool:
        """It begins with the version of the format."""
        return not content.binary and content.first.lstrip('"').startswith("Format Version")

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """Times are the file's own; without their column frames over the export's rate."""
        where = cls.where(content.path)
        separator = separator_of([content.first])
        rows = content.rows(separator)
        keys = _keys(content.first, separator)
        scale, unit = cls.scale(content, asked, keys.get("length units", ""), CURE)
        head = next((k for k, row in enumerate(rows) if row and row[0].lower() == "frame"), None)
        if head is None:
            raise FitError(f"{where} has no row that begins with Frame: export markers with their header")
        data = [(k + 1, row) for k, row in enumerate(rows) if k > head and not blank(row)]
        if len(data) < 2:
            raise FitError(f"{where} holds {len(data)} rows of samples; a motion needs at least two")
        columns, notes = _markers(where, rows[1:head], rows[head])
        names = short_names(list(columns))
        places = [(c, f"{name} {axis}") for name in columns for c, axis in zip(columns[name], "XYZ", strict=True)]
        values = table(where, data, places, separator != ",") * scale
        clock = next((k for k, cell in enumerate(rows[head]) if cell.lower().startswith("time (")), None)
        if clock is not None and asked.rate is None:
            times = table(where, data, [(clock, rows[head][clock])], separator != ",")[:, 0]
        else:
            frames = table(where, data, [(0, "Frame")], False)[:, 0]
            rate = keys.get("export frame rate") or keys.get("capture frame rate") or ""
            times = cls.times(content, frames, rate_of(rate), asked, "give rate=")
        notes = [*cls.counted(keys.get("total exported frames", ""), len(data)), *notes]
        notes = [*cls.overruled(asked, keys.get("length units", "")), *notes]
        up = f"the file's axes are kept (Motive's Y points up; {keys.get('coordinate space', 'Global')} coordinates)"
        return cls.made(content, times, values.reshape(len(data), -1, 3), names, unit, [*notes, up])


def _keys(line: str, separator: str) -> dict[str, str]:
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    return {key.lower(): value for key, value in zip(cells[0::2], cells[1::2], strict=False)}


def _markers(where: str, rows: list[list[str]], axes: list[str]) -> tuple[dict[str, list[int]], list[str]]:
    """Columns X, Y, Z of each measured marker, and what is left out. Rows go by what stands in them, since some
    versions do not label them."""
    width = len(axes)
    padded = [row + [""] * (width - len(row)) for row in rows if not blank(row)]
    kinds = max(range(len(padded)), key=lambda k: sum(c.lower() in KINDS for c in padded[k]), default=None)
    if kinds is None or not any(cell.lower() in KINDS for cell in padded[kinds]):
        raise FitError(f"{where} has no row of types (Marker, Rigid Body, ...): export with the full header")
    labelled = [k for k, row in enumerate(padded) if "name" in (row[0].lower(), row[1].lower())]
    named = padded[labelled[0] if labelled else min(kinds + 1, len(padded) - 1)]
    what = next((row for row in padded if any(c.lower() == "position" for c in row)), ["position"] * width)
    found: dict[str, dict[str, int]] = {}
    left: dict[str, set[str]] = {}
    for k in range(width):
        if axes[k].upper() not in ("X", "Y", "Z") or what[k].lower() != "position":
            continue
        if padded[kinds][k].lower() == "marker":
            own = found.setdefault(named[k], {})
            if "unlabeled" not in named[k].lower():
                check_once(where, named[k], axes[k].upper(), own)
            own[axes[k].upper()] = k
        else:
            left.setdefault(padded[kinds][k], set()).add(named[k])
    loose = [name for name in found if "unlabeled" in name.lower()]
    notes = [f"no measured markers, so left out: {len(each)} of type {kind}" for kind, each in left.items()]
    if loose and len(loose) < len(found):
        notes.append(f"left out: {len(loose)} unlabelled fragments")
        found = {name: each for name, each in found.items() if name not in loose}
    if not found:
        solved = f" It has {clipped(sorted(left))}, which are solved, not measured." if left else ""
        raise FitError(f"{where} holds no column of type Marker.{solved} Export with Markers ticked")
    for name, each in found.items():
        if len(each) < 3:
            raise FitError(f'{where}: marker "{name}" lacks one of its columns X, Y, Z')
    return {name: [each[axis] for axis in "XYZ"] for name, each in found.items()}, notes
