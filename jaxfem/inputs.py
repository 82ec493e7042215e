"""What the fields of a declaration take: quantity, unit, range. Scene files read by it, and checks name what is wrong.

A field says so in its metadata, `radius: Any = field(metadata=takes(Number("m", positive=True)))`, and one without it
is for Python alone. A new kind of value is a subclass of `Input`, wherever it is defined.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any, ClassVar, Protocol, dataclass_transform

import numpy as np

REQUIRED: Any = object()  # a default that says: there is none
SURFACE_KEYS = ("file", "scale")
"""Keys of a table that names a surface's file."""


class TableLike(Protocol):
    """A checked table of a scene file, as `jaxfem.io.toml_tables.Table` is."""

    where: str

    def __contains__(self, key: str) -> bool: ...
    def get(self, key: str, default: Any = REQUIRED, unit: str = "") -> Any:
        """The value of a key, or `default`; without one a missing key is an error."""

    def number(self, key: str, default: Any = REQUIRED, unit: str = "", positive: bool = False) -> Any:
        """A finite number."""

    def integer(self, key: str, default: Any = REQUIRED) -> Any:
        """A whole number, at least 1."""

    def vector(self, key: str, default: Any = REQUIRED, unit: str = "", length: int = 3) -> Any:
        """`length` finite numbers."""

    def grid(self, key: str, default: Any = REQUIRED, unit: str = "", what: str = "numbers") -> Any:
        """Rows of numbers of one length."""

    def text(self, key: str, default: Any = REQUIRED) -> Any:
        """A text that is not empty."""

    def flag(self, key: str, default: Any = REQUIRED) -> Any:
        """True or false."""

    def table(self, key: str, known: Iterable[str] | None, where: str) -> "TableLike":
        """A table inside this one, with its `known` keys; `where` names it in messages."""


class Sources(Protocol):
    """What a scene file's words refer to beyond the table they stand in."""

    def nodes(self, table: TableLike, key: str) -> Any:
        """Nodes that a selection names, of the soft body which the table calls `a`."""

    def surface(self, table: TableLike) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) [m] and triangles (t, 3) of the surface that `file` and `scale` of a table name."""


@dataclasses.dataclass(frozen=True)
class Input:
    """One field's value. `optional`: None where the table leaves it out; otherwise it needs a default or a value."""

    optional: bool = dataclasses.field(default=False, kw_only=True)
    example: ClassVar[str] = "..."

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """The value that `key` of a table gives, `default` without it; errors name table and key."""
        raise NotImplementedError

    def flaw(self, value: Any) -> str:
        """What is to be done about a value that cannot be; empty where it can."""
        return ""


@dataclasses.dataclass(frozen=True)
class Number(Input):
    """One number."""

    unit: str = ""
    positive: bool = dataclasses.field(default=False, kw_only=True)
    example: ClassVar[str] = "0.1"

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """A finite number."""
        return table.number(key, default, self.unit, self.positive)

    def flaw(self, value: Any) -> str:
        """It must be finite, and positive where that is asked for."""
        return _flaw_of_numbers(value, (), self.unit, self.positive)


@dataclasses.dataclass(frozen=True)
class Count(Input):
    """A whole number, at least 1."""

    example: ClassVar[str] = "2"

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """Such a number."""
        return table.integer(key, default)

    def flaw(self, value: Any) -> str:
        """It must be one."""
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        return "" if whole and value >= 1 else "give a whole number of at least 1"


@dataclasses.dataclass(frozen=True)
class Vector(Input):
    """`length` numbers."""

    unit: str = ""
    length: int = 3
    positive: bool = dataclasses.field(default=False, kw_only=True)
    example: ClassVar[str] = "[1, 1, 1]"

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """A tuple of finite numbers."""
        return table.vector(key, default, self.unit, self.length)

    def flaw(self, value: Any) -> str:
        """They must be finite, and positive where that is asked for."""
        return _flaw_of_numbers(value, (self.length,), self.unit, self.positive)


@dataclasses.dataclass(frozen=True)
class Direction(Vector):
    """A direction (3,), of any length but zero."""

    example: ClassVar[str] = "[0, 0, 1]"

    def flaw(self, value: Any) -> str:
        """It must point somewhere."""
        return super().flaw(value) or ("" if np.any(value) else "give a direction")


@dataclasses.dataclass(frozen=True)
class Grid(Input):
    """`what`, numbers over a grid: at least two rows of at least two, all of one length."""

    unit: str = ""
    what: str = "numbers"
    example: ClassVar[str] = "[[0, 0], [0, 1]]"

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """An array (nx, ny)."""
        return table.grid(key, default, self.unit, self.what)


@dataclasses.dataclass(frozen=True)
class Text(Input):
    """A name; with `optional`, None stands for the world or for none."""

    example: ClassVar[str] = '"name"'

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """A text that is not empty."""
        return table.text(key, default)


@dataclasses.dataclass(frozen=True)
class Flag(Input):
    """True or false."""

    example: ClassVar[str] = "true"

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """True or false."""
        return table.flag(key, default)


@dataclasses.dataclass(frozen=True)
class Nodes(Input):
    """A selection of nodes of the soft body `a`."""

    example: ClassVar[str] = '"x+"'

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """Node numbers."""
        return sources.nodes(table, key) if key in table else default


@dataclasses.dataclass(frozen=True)
class Vertices(Input):
    """Points (q, 3) [m] of a surface's file, or true: those of the body's own surface."""

    example: ClassVar[str] = "{ file = 'skin.stl' }"

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """The vertices; True for those of the body's own surface."""
        if key not in table:
            return default
        if table.get(key) is True:
            return True
        return sources.surface(table.table(key, SURFACE_KEYS, f"{key!r} in {table.where}"))[0]


@dataclasses.dataclass(frozen=True)
class Nested(Input):
    """A declaration inside another: a table of its own. It may be left out."""

    made: type
    example: ClassVar[str] = "{ ... }"

    def read(self, table: TableLike, key: str, default: Any, sources: Sources) -> Any:
        """An object of the class that is declared inside."""
        if key not in table:
            return default
        inner = table.table(key, inputs_of(self.made), f"{key!r} in {table.where}")
        return self.made(**read_fields(self.made, inner, sources))


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(dataclasses.field,))
class Declared:
    """Base class: each subclass is a frozen dataclass, equal to itself alone."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        dataclasses.dataclass(frozen=True, eq=False)(cls)


def takes(value: Input) -> dict[str, Input]:
    """A field's metadata."""
    return {"takes": value}


def inputs_of(made: Any) -> dict[str, Input]:
    """Fields of a declaration (a dataclass or one's instance) that scene files give, in order."""
    return {field.name: field.metadata["takes"] for field in dataclasses.fields(made) if "takes" in field.metadata}


def read_fields(
    made: type, table: TableLike, sources: Sources, left: Iterable[str] = (), keys: dict[str, str] | None = None
) -> dict[str, Any]:
    """Values of a declaration's fields by a table, but for those named in `left`; `keys`: where a key differs."""
    defaults = {field.name: field.default for field in dataclasses.fields(made)}
    values = {}
    for name, each in inputs_of(made).items():
        if name not in left:
            default = defaults[name]
            if default is dataclasses.MISSING or default is None:
                default = None if each.optional else REQUIRED
            values[name] = each.read(table, (keys or {}).get(name, name), default, sources)
    return values


def _flaw_of_numbers(value: Any, shape: tuple[int, ...], unit: str, positive: bool) -> str:
    try:
        array = np.asarray(value)
    except ValueError:  # a ragged list
        array = np.zeros(0)
    if np.issubdtype(array.dtype, np.number) and array.shape == shape and np.isfinite(array).all():
        if not positive or (array > 0).all():
            return ""
    if positive and unit == "m":
        return "lengths must be positive, in m"
    one = "a positive number" if positive else "a finite number"
    return f"give {f'{shape[0]} finite numbers' if shape else one}" + (f" in {unit}" if unit else "")
