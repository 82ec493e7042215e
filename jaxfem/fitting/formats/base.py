"""What a format is: a class that recognises a file's content and reads it, entered by its definition."""

import dataclasses
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
            raise FitError(f"{cls.where(content.path)} has frame numbers and no rate ({rate}): {cure}")
        return np.asarray((frames - frames[0]) / rate)


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
