"""TRC files, as OpenSim and Motion Analysis write them: two rows of keys and values, names, then X1, Y1, Z1."""

import itertools

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.base import Format, Request, short_names
from jaxfem.fitting.formats.content import Content, blank, rate_of, table
from jaxfem.fitting.recording import Recording


class Trc(Format, word="trc"):
    """Marker k has the columns Xk, Yk, Zk, wherever they stand."""

    title = "TRC"

    @classmethod
    def claims(cls, content: Content) -> bool:
        """It begins with PathFileType."""
        return not content.binary and content.first.startswith("PathFileType")

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """Times are the file's own."""
        where = cls.where(content.path)
        rows = content.rows("\t")
        head = next((k for k, row in enumerate(rows) if row and row[0].lower().startswith("frame")), None)
        if head is None or head + 2 > len(rows):
            raise FitError(f"{where} has no row that begins with Frame#: it may not be parted by tabs; export it again")
        keys = _keys(rows[:head])
        names = [cell for cell in rows[head][2:] if cell]
        axes = {cell.upper(): k for k, cell in enumerate(rows[head + 1]) if cell}
        data = [(k + 1, row) for k, row in enumerate(rows) if k > head + 1 and not blank(row)]
        if len(data) < 2:
            raise FitError(f"{where} holds {len(data)} rows of samples; a motion needs at least two")
        columns = []
        for k, name in enumerate(names, 1):
            missing = [f"{axis}{k}" for axis in "XYZ" if f"{axis}{k}" not in axes]
            if missing:
                raise FitError(f'{where}: marker "{name}" lacks the column {", ".join(missing)}')
            columns += [(axes[f"{axis}{k}"], f"{name} {axis}{k}") for axis in "XYZ"]
        if not names:
            raise FitError(f"{where} names no marker in its row Frame#")
        scale, unit = cls.scale(content, asked, keys.get("units", ""), 'give unit="mm"')
        values = scale * table(where, data, columns, True).reshape(len(data), -1, 3)
        clock = table(where, data, [(0, "Frame#"), (1, "Time")], True)
        times = clock[:, 1]
        if asked.rate is not None or not np.isfinite(times).all():
            stated = rate_of(keys.get("datarate", ""))
            times = cls.times(content, clock[:, 0], stated, asked, "give rate=")
        notes = [
            *cls.counted(keys.get("numframes", ""), len(data)),
            *cls.overruled(asked, keys.get("units", "")),
            "the file's axes are kept (Y points up)",
        ]
        return cls.made(content, times, values, short_names(names), unit, notes)


def _keys(rows: list[list[str]]) -> dict[str, str]:
    """A row of keys and one of values below it; found by the key DataRate."""
    for keys, values in itertools.pairwise(rows):
        if any(cell.lower() == "datarate" for cell in keys):
            return {key.lower(): value for key, value in zip(keys, values, strict=False)}
    return {}
