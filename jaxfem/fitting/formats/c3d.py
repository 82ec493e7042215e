"""C3D files (c3d.org), read by ezc3d (Michaud & Begon 2021)."""

import struct

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.base import Format, Request, short_names
from jaxfem.fitting.formats.content import Content
from jaxfem.fitting.recording import Recording


class C3d(Format, word="c3d"):
    """Places of POINT, with its labels, unit and rate; a residual of -1 marks a lost sample."""

    title = "C3D"

    @classmethod
    def claims(cls, content: Content) -> bool:
        """Its second byte is 0x50, and it is no text."""
        return content.data[1:2] == b"\x50" and content.data[0] < 32 and b"\0" in content.data[:512]

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """FitError where ezc3d is not installed."""
        where = cls.where(content.path)
        try:
            import ezc3d
        except ImportError as error:
            raise FitError(f"{where} needs the package ezc3d: pip install 'jaxfem[c3d]'") from error
        try:
            file = ezc3d.c3d(str(content.path))
        except Exception as error:  # whatever the reader raises of a broken file
            raise FitError(f"{where} cannot be read: {error}") from error
        point, data = file["parameters"]["POINT"], file["data"]
        places = np.asarray(data["points"], dtype=np.float64)[:3]
        names = [str(name).strip() for name in point["LABELS"]["value"]][: places.shape[1]]
        if not names:
            raise FitError(f"{where} holds no points")
        residual = np.asarray(data["meta_points"]["residuals"], dtype=np.float64)[0]
        lost = (residual < 0) | (places == 0).all(axis=0)
        stated = [str(word) for word in point.get("UNITS", {}).get("value", [])]
        scale, unit = cls.scale(content, asked, stated[0] if stated else "", 'give unit="mm"')
        first = int(file["header"]["points"]["first_frame"])
        rate = float(np.ravel(point["RATE"]["value"])[0])
        times = cls.times(content, np.arange(places.shape[2], dtype=float), rate, asked, "give rate=")
        positions = scale * np.where(lost, np.nan, places).transpose(2, 1, 0)
        notes = cls.counted(_stated(content.data), places.shape[2])
        notes += cls.overruled(asked, stated[0] if stated else "")
        notes += [f"time 0 is frame {first + 1}"] if first else []
        return cls.made(content, times, positions, short_names(names), unit, notes)


def _stated(data: bytes) -> str:
    """How many frames the header states: the reader counts those that are there. Nothing where the file's bytes are
    not in the usual order, or the numbers are too large for the header."""
    kind = 512 * (data[0] - 1) + 3
    first, last = struct.unpack_from("<HH", data, 6)
    return str(last - first + 1) if len(data) > kind and data[kind] == 84 and first <= last < 65535 else ""
