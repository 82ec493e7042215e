"""Checked access to TOML tables: a wrong type, a missing or an unknown key is refused by name, with a suggestion."""

import difflib
import math
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.inputs import REQUIRED


class SceneFileError(ValueError):
    """A scene file that cannot be used; the message names the file, the table, the key and the remedy."""


def read_toml(path: Path) -> dict[str, Any]:
    """The top table of a TOML file. FileNotFoundError, or SceneFileError with the line of a syntax error."""
    if not path.is_file():
        if path.is_dir():
            raise FileNotFoundError(f"{path} is a folder: give a scene file, a .toml in it")
        near = sorted(each.name for each in path.parent.glob("*.toml"))[:8] if path.parent.is_dir() else []
        raise FileNotFoundError(f"no scene file {path}" + (f": the folder holds {', '.join(near)}" if near else ""))
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise SceneFileError(f"{path} is not valid TOML: {problem}") from problem


def suggestion(word: str, known: Iterable[str], taken: Iterable[str] = ()) -> str:
    """`: did you mean 'young'?` for a word near one that is not `taken` yet, else the known words."""
    words = sorted(known)
    near = difflib.get_close_matches(word, [each for each in words if each not in taken], n=1, cutoff=0.6)
    if near:
        return f": did you mean {near[0]!r}?"
    return f": known are {', '.join(words)}" if words else ""


class Table:
    """One TOML table, called `where` in messages, that may hold only the keys in `known` (None: any).

    Each accessor returns the checked value of a key, or `default` where the key is absent; without a default the key is
    required. SceneFileError for everything else.
    """

    def __init__(self, values: Any, where: str, known: Iterable[str] | None):
        if not isinstance(values, dict):
            raise SceneFileError(f"{where} is {described(values)}: it must be a table")
        self.values, self.where = values, where
        for key in values if known is not None else ():
            if key not in (known := tuple(known or ())):
                raise SceneFileError(f"unknown key {key!r} in {where}{suggestion(key, known, values)}")

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def wrong(self, key: str, wanted: str) -> SceneFileError:
        """The error for a value of the wrong kind."""
        return SceneFileError(f"{key!r} in {self.where} is {described(self.values[key])}: it must be {wanted}")

    def get(self, key: str, default: Any = REQUIRED, unit: str = "") -> Any:
        """The raw value."""
        if key not in self.values and default is REQUIRED:
            raise SceneFileError(f"missing key {key!r} in {self.where}" + (f": give it in {unit}" if unit else ""))
        return self.values.get(key, default)

    def number(self, key: str, default: Any = REQUIRED, unit: str = "", positive: bool = False) -> Any:
        """A finite number."""
        value = self.get(key, default, unit)
        if key in self.values:
            of_unit = f" of {unit}" if unit else ""
            if not is_number(value):
                raise self.wrong(key, f"a finite number{of_unit}")
            if positive and value <= 0:
                raise self.wrong(key, f"a positive number{of_unit}")
        return float(value) if is_number(value) else value

    def integer(self, key: str, default: Any = REQUIRED) -> Any:
        """A whole number, at least 1."""
        value = self.get(key, default)
        if key in self.values and not (is_integer(value) and value >= 1):
            raise self.wrong(key, "a whole number, at least 1")
        return value

    def count(self, key: str, default: Any = REQUIRED) -> Any:
        """A whole number, at least 0."""
        value = self.get(key, default)
        if key in self.values and not (is_integer(value) and value >= 0):
            raise self.wrong(key, "a whole number, at least 0")
        return value

    def vector(self, key: str, default: Any = REQUIRED, unit: str = "", length: int = 3) -> Any:
        """A tuple of finite numbers."""
        value = self.get(key, default, unit)
        if key in self.values:
            if not (isinstance(value, list) and len(value) == length and all(is_number(each) for each in value)):
                raise self.wrong(key, f"a list of {length} finite numbers" + (f" in {unit}" if unit else ""))
            return tuple(float(each) for each in value)
        return value

    def text(self, key: str, default: Any = REQUIRED) -> Any:
        """A string that is not empty."""
        value = self.get(key, default)
        if key in self.values and not (isinstance(value, str) and value):
            raise self.wrong(key, "a text in quotes")
        return value

    def flag(self, key: str, default: Any = REQUIRED) -> Any:
        """True or false."""
        value = self.get(key, default)
        if key in self.values and not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def grid(self, key: str, default: Any = REQUIRED, unit: str = "", what: str = "numbers") -> Any:
        """An array (nx, ny) of finite numbers, at least 2 by 2."""
        value = self.get(key, default, unit)
        if key not in self.values:
            return value
        rows = value if isinstance(value, list) and all(isinstance(row, list) for row in value) else []
        even = len(rows) >= 2 and len({len(row) for row in rows}) == 1 and len(rows[0]) >= 2
        if not even or not all(is_number(each) for row in rows for each in row):
            of_unit = f" in {unit}" if unit else ""
            raise self.wrong(key, f"at least two rows of at least two {what}{of_unit}, all of one length")
        return np.array(value, float)

    def choice(self, key: str, known: Sequence[str], default: Any = REQUIRED) -> Any:
        """One of the `known` words."""
        value = self.text(key, default)
        if key in self.values and value not in known:
            raise SceneFileError(f"{key!r} in {self.where} is {value!r}{suggestion(value, known)}")
        return value

    def table(self, key: str, known: Iterable[str] | None, where: str) -> "Table":
        """A table inside this one; an empty one where it is absent."""
        return Table(self.values.get(key, {}), where, known)

    def tables(self, key: str, heading: str) -> list[dict[str, Any]]:
        """The raw tables of a list of tables; empty where it is absent."""
        value = self.values.get(key, [])
        if isinstance(value, dict):
            raise SceneFileError(f"[{heading}] in {self.where} is a single table: write [[{heading}]] for each one")
        if not (isinstance(value, list) and all(isinstance(each, dict) for each in value)):
            raise self.wrong(key, f"a list of tables, each under [[{heading}]]")
        return value


def is_number(value: Any) -> bool:
    """Whether a TOML value is one finite number; true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def is_integer(value: Any) -> bool:
    """Whether a TOML value is a whole number; true and false are not."""
    return isinstance(value, int) and not isinstance(value, bool)


def described(value: Any) -> str:
    """A value as messages show it, with its kind where that is the likely mistake."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, str):
        return f'the text "{value}"'
    shown = repr(value)
    return shown if len(shown) <= 60 else shown[:57] + "..."
