"""Kinds of one thing by the word that scene files call each: classes enter as they are defined."""

import dataclasses
import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from typing import Any, Generic, TypeVar

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Kind(Generic[T]):
    """A class, and values of its fields that the word fixes ("rope": a DistanceJoint with rope=True)."""

    made: type[T]
    fixed: Mapping[str, Any]


class Registry(Generic[T]):
    """The kinds of `what`, in the order of their definition."""

    def __init__(self, what: str):
        self.what = what
        self._kinds: dict[str, Kind[T]] = {}

    def add(self, word: str, made: type[T], **fixed: Any) -> None:
        """Enter a class under a word. TypeError where another class has it, or where it is no text; the same one
        defined again replaces it."""
        if not isinstance(word, str) or not word:
            raise TypeError(f"{_place(made)} calls itself {self.what} {word!r}: give a word, a text that is not empty")
        known = self._kinds.get(word)
        if known is not None and _place(known.made) != _place(made):
            raise TypeError(
                f'{_place(made)} calls itself {self.what} "{word}", which {_place(known.made)} is: give it another word'
            )
        self._kinds[word] = Kind(made, fixed)

    def remove(self, word: str) -> None:
        """Forget a word, as where a class was defined for a moment."""
        del self._kinds[word]

    def __contains__(self, word: object) -> bool:
        return word in self._kinds

    def __getitem__(self, word: str) -> Kind[T]:
        return self._kinds[word]

    def words(self) -> tuple[str, ...]:
        """All words."""
        return tuple(self._kinds)

    def classes(self) -> tuple[type[T], ...]:
        """All classes, each once."""
        return tuple(dict.fromkeys(kind.made for kind in self._kinds.values()))


def import_folder(package: str, folder: Iterable[str]) -> None:
    """Import every module of a package's folder (`__name__`, `__path__`), so that what it defines has entered.

    A new file is all that a new kind needs then.
    """
    for module in pkgutil.iter_modules(folder):
        importlib.import_module(f"{package}.{module.name}")


def _place(made: type) -> str:
    return f"{made.__module__}.{made.__qualname__}"
