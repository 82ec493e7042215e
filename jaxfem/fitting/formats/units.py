"""Units of lengths and times by the words that files use."""

from jaxfem.fitting.errors import FitError

LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "um": 1e-6, "nm": 1e-9, "km": 1e3, "in": 0.0254, "ft": 0.3048}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
PIXELS = "px"
_WORDS = {
    **{word: "m" for word in ("meter", "meters", "metre", "metres")},
    **{word: "mm" for word in ("millimeter", "millimeters", "millimetre", "millimetres")},
    **{word: "cm" for word in ("centimeter", "centimeters", "centimetre", "centimetres")},
    **{word: "um" for word in ("micrometer", "micrometers", "micrometre", "micrometres", "µm", "μm")},
    **{word: "in" for word in ("inch", "inches")},
    **{word: "ft" for word in ("foot", "feet")},
    **{word: "s" for word in ("sec", "secs", "second", "seconds")},
    **{word: "ms" for word in ("msec", "millisecond", "milliseconds")},
    **{word: "us" for word in ("usec", "µs", "μs", "microsecond", "microseconds")},
    **{word: "min" for word in ("minute", "minutes")},
    **{word: PIXELS for word in ("pixel", "pixels", "pix")},
}


def short(word: str) -> str:
    """The unit's usual sign."""
    plain = word.strip().strip("[]()").strip().lower()
    return _WORDS.get(plain, plain)


def length(word: str, where: str) -> float:
    """Metres in a unit of length; FitError, beginning with `where`, for a word that is none."""
    if short(word) not in LENGTHS:
        raise FitError(f'{where}: "{word}" is no unit of length; known: {", ".join(LENGTHS)}')
    return LENGTHS[short(word)]
