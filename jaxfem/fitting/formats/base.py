"""What a format is: a class that recognises a file's content and reads it, entered by its definition."""

import dataclasses
import numbers
import pathlib
from collections.abc import Collection, Sequence
from typing import Any, ClassVar

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats import units
from jaxfem.fitting.formats.content import Content
from jaxfem.fitting.recording import Recording
from jaxfem.registry import Registry


@dataclasses.dataclass(frozen=True)
class Request:
    """What a file may leave open, as a user gives it: `unit` of lengths, `rate` [1/s], `camera` (3, 4) of pixels."""

    unit: str | None = None
    rate: float | None = None
    camera: Any = None

    def __post_init__(self) -> None:
        if self.unit is not None and not isinstance(self.unit, str):
            raise FitError(f'unit is {self.unit!r}: give the word for it, like unit="mm"')
        number = isinstance(self.rate, numbers.Real) and not isinstance(self.rate, bool)
        if self.rate is not None and not (number and 0 < float(self.rate) < np.inf):
            raise FitError(f"rate is {self.rate!r}: give the rows a second, a number above 0, like rate=100")


class Format:
    """Base class. `title` names it to people; `fallback`: it takes what nobody else claims."""

    title: ClassVar[str] = ""
    fallback: ClassVar[bool] = False

    def __init_subclass__(cls, word: str = "", **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if word:
            FORMATS.add(word, cls)

    @classmethod
    def claims(cls, content: Content) -> bool:
        """Whether a file's content is of this format."""
        raise NotImplementedError

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """The recording; FitError, beginning with `where`, for what cannot be read."""
        raise NotImplementedError

    @classmethod
    def where(cls, path: pathlib.Path) -> str:
        """How its messages begin."""
        return f"{path} ({cls.title})"

    @classmethod
    def scale(cls, content: Content, asked: Request, stated: str, cure: str) -> tuple[float, str]:
        """Metres in the file's unit, and its sign. What is asked for goes before what the file states; `cure` ends the
        message where neither says one."""
        word = asked.unit or stated
        if not word:
            raise FitError(f"{cls.where(content.path)} does not say the unit of its places: {cure}")
        return units.length(word, cls.where(content.path)), units.short(word)

    @classmethod
    def overruled(cls, asked: Request, stated: str) -> list[str]:
        """A note where another unit is asked for than the file states."""
        if not asked.unit or not stated or units.short(asked.unit) == units.short(stated):
            return []
        return [f"its unit is taken for {units.short(asked.unit)}, as asked, where the file states {stated}"]

    @classmethod
    def made(
        cls,
        content: Content,
        times: np.ndarray,
        positions: np.ndarray,
        names: Sequence[str],
        unit: str,
        notes: Sequence[str] = (),
        **more: Any,
    ) -> Recording:
        """A recording of `positions` (T, M, 3) [m] that knows where it comes from. Rows that repeat the one before
        exactly, and markers that are nowhere seen, are left out and noted."""
        told = list(notes)
        rows = np.concatenate([times[:, None], positions.reshape(len(times), -1)], axis=1)
        repeated = np.r_[
            False, [np.array_equal(a, b, equal_nan=True) for a, b in zip(rows[1:], rows[:-1], strict=True)]
        ]
        if repeated.any():
            told.append(f"{int(repeated.sum())} rows that repeat the one before are left out")
            times, positions = times[~repeated], positions[~repeated]
        seen = np.isfinite(positions).all(axis=-1).any(axis=0)
        if not seen.all() and seen.any():
            told.append(f"never seen, so left out: {', '.join(n for n, s in zip(names, seen, strict=True) if not s)}")
            positions, names = positions[:, seen], [n for n, s in zip(names, seen, strict=True) if s]
        try:
            return Recording(times, positions, names, notes=tuple(told), source=cls.title, unit=unit, **more)
        except FitError as error:
            raise FitError(f"{cls.where(content.path)}: {error}") from error

    @classmethod
    def times(cls, content: Content, frames: np.ndarray, stated: float | None, asked: Request, cure: str) -> np.ndarray:
        """Times [s] of frame numbers, 0 at the first; FitError, ending with `cure`, where no rate is known."""
        rate = asked.rate if asked.rate is not None else stated
        if rate is None or not (np.isfinite(rate) and rate > 0):
            told = "" if rate is None else f" that can be ({rate})"
            raise FitError(f"{cls.where(content.path)} has frame numbers and no rate{told}: {cure}")
        return np.asarray((frames - frames[0]) / rate)

    @classmethod
    def counted(cls, stated: str, rows: int) -> list[str]:
        """A note where a file has another number of rows than it states, as one has that was cut off."""
        if not stated.strip().isdigit() or int(stated) == rows:
            return []
        return [f"the file states {int(stated)} rows, and holds {rows}: it may be cut off, its last number too"]


FORMATS: Registry[Format] = Registry("a format of recordings")


def short_names(names: Sequence[str]) -> list[str]:
    """Names without the subject before a colon, where they still differ then."""
    cut = [name.rsplit(":", 1)[-1].strip() for name in names]
    return cut if len(set(cut)) == len(cut) and all(cut) else list(names)


def clipped(words: Sequence[str], most: int = 8) -> str:
    """A list for a message, cut where it is long."""
    return ", ".join(words[:most]) + (f", ... ({len(words)} in all)" if len(words) > most else "")


def check_once(where: str, name: str, axis: str, there: Collection[str]) -> None:
    """FitError where a marker's name, or its `axis`, is `there` already: two markers of one name cannot be told."""
    if (axis or name) in there:
        raise FitError(f'{where}: two markers are named "{name}": rename one in the capture software and export again')
