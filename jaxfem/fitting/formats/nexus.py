"""Vicon Nexus's CSV export (ASCII): the section Trajectories, its rate, names, axes and units."""

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.base import Format, Request, check_once, short_names
from jaxfem.fitting.formats.content import Content, blank, rate_of, separator_of, table
from jaxfem.fitting.recording import Recording

SECTIONS = ("trajectories", "devices", "model outputs", "joints", "segments")


class Nexus(Format, word="nexus"):
    """Sections other than Trajectories, velocities and accelerations are left out; time is 0 at the first frame."""

    title = "Vicon Nexus CSV"

    @classmethod
    def claims(cls, content: Content) -> bool:
        """It begins with the name of a section, and a rate below it."""
        return not content.binary and content.first.strip(' \t,;"').lower() in SECTIONS

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """Frames need not start at 1, nor follow without gaps."""
        where = cls.where(content.path)
        heads = [k for k, line in enumerate(content.lines) if line.strip(' \t,;"').lower() == "trajectories"]
        if not heads:
            raise FitError(f"{where} has no section Trajectories: export the trajectories of the markers")
        separator = separator_of([line for line in content.lines[heads[0] :] if "frame" in line.lower()])
        rows = content.rows(separator)
        top = heads[0]
        axes = next((k for k in range(top, min(top + 8, len(rows))) if rows[k] and rows[k][0].lower() == "frame"), None)
        if axes is None or axes < top + 3 or len(rows) < axes + 2:
            raise FitError(
                f"{where}: the section Trajectories has no row Frame, Sub Frame, X, Y, Z below rate and names"
            )
        end = next((k for k in range(axes + 2, len(rows)) if blank(rows[k])), len(rows))
        data = [(k + 1, rows[k]) for k in range(axes + 2, end)]
        if len(data) < 2:
            raise FitError(f"{where} holds {len(data)} rows of samples; a motion needs at least two")
        columns = _columns(where, rows[axes - 1], rows[axes])
        stated_unit = _unit(where, rows[axes + 1], columns)
        scale, unit = cls.scale(content, asked, stated_unit, 'give unit="mm"')
        places = [
            (0, "Frame"),
            *((c, f"{name} {a}") for name, cs in columns.items() for c, a in zip(cs, "XYZ", strict=True)),
        ]
        values = table(where, data, places, separator != ",")
        stated = next((cell for cell in rows[top + 1] if cell), "")
        times = cls.times(content, values[:, 0], rate_of(stated), asked, "give rate=")
        notes = [
            *cls.overruled(asked, stated_unit),
            f"time 0 is frame {values[0, 0]:g}",
            "the file's axes are kept (Nexus's Z points up)",
        ]
        others = [k for k, line in enumerate(content.lines) if line.strip(' \t,;"').lower() in SECTIONS and k != top]
        if others:
            notes.append(f"left out: section {', '.join(content.lines[k].strip(' ,;') for k in others)}")
        places3 = scale * values[:, 1:].reshape(len(data), -1, 3)
        return cls.made(content, times, places3, short_names(list(columns)), unit, notes)


def _columns(where: str, names: list[str], axes: list[str]) -> dict[str, list[int]]:
    """Columns X, Y, Z of each marker: a name stands above its first."""
    starts = [k for k, cell in enumerate(names) if cell]
    found: dict[str, list[int]] = {}
    for k, after in zip(starts, [*starts[1:], len(axes)], strict=True):
        own = {axes[c].upper(): c for c in reversed(range(k, min(after, len(axes))))}
        if all(axis in own for axis in "XYZ"):
            check_once(where, names[k], "", found)
            found[names[k]] = [own[axis] for axis in "XYZ"]
    if not found:
        raise FitError(f"{where}: no marker has columns X, Y and Z: export trajectories with all components")
    return found


def _unit(where: str, row: list[str], columns: dict[str, list[int]]) -> str:
    signs = {row[c] for cs in columns.values() for c in cs if c < len(row) and row[c]}
    if len(signs) > 1:
        raise FitError(f"{where} gives places in {' and '.join(sorted(signs))}: export them in one unit")
    return signs.pop() if signs else ""
