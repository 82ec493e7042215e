"""Which values a number may have: declared beside the field that holds it, looked at inside compiled functions too.

A field of a Pytree says so in its metadata, `compliance: Any = field(metadata=within(low=0))`. Of a field that says
nothing only NaN is refused.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.pytrees import is_key

Array = jax.Array


@dataclasses.dataclass(frozen=True)
class Range:
    """Admissible are values from `low` to `high`, with `open_low` only above `low` and with `open_high` below `high`;
    infinite ones only where `infinite`. `advice` ends a sentence that begins with the number's name."""

    low: float = -float("inf")
    high: float = float("inf")
    open_low: bool = False
    open_high: bool = False
    infinite: bool = False
    advice: str = ""

    def wrong(self, value: Any) -> Array:
        """Where `value` cannot be, a bool for each number; of an array on the host worked out there."""
        known = _known(value)
        with np.errstate(over="ignore"):  # a limit beyond single precision is none there
            above = known > self.low if self.open_low else known >= self.low
            below = known < self.high if self.open_high else known <= self.high
        good = above & below
        wrong: Array = ~(good if self.infinite else good & (abs(known) < float("inf")))
        return wrong

    @property
    def text(self) -> str:
        """What the value must be, after the number's name."""
        if self.advice:
            return self.advice
        words = []
        if self.low > -float("inf"):
            words.append(f"{'more than' if self.open_low else 'at least'} {self.low:g}")
        if self.high < float("inf"):
            words.append(f"{'less than' if self.open_high else 'at most'} {self.high:g}")
        words.append("not NaN" if self.infinite else "finite")
        return f"must be {' and '.join(words)}"


def _known(value: Any) -> Any:
    return value if isinstance(value, np.ndarray | np.generic) else jnp.asarray(value)


@dataclasses.dataclass(frozen=True)
class Directions(Range):
    """Rows of numbers (..., k), finite and not all zero: directions, quaternions."""

    def wrong(self, value: Any) -> Array:
        """Where a row cannot be, (..., 1)."""
        known = _known(value)
        off: Array = super().wrong(known).any(-1, keepdims=True) | (known == 0).all(-1, keepdims=True)
        return off


@dataclasses.dataclass(frozen=True)
class Units(Directions):
    """Rows of numbers of length one: a pose's quaternions, which turn by their angle alone."""

    def wrong(self, value: Any) -> Array:
        """Where a row is none, or its length is off by more than rounding, (..., 1)."""
        known = jnp.asarray(value)
        off: Array = super().wrong(known) | (jnp.abs(jnp.sum(known**2, -1, keepdims=True) - 1) > OFF)
        return off


OFF = 1e-3
"""Of the square of a unit's length."""
FINITE = Range()
NOT_NAN = Range(infinite=True)


def within(
    low: float = -float("inf"), high: float = float("inf"), *, open_low: bool = False, infinite: bool = False
) -> dict[str, Range]:
    """A field's metadata."""
    return {"range": Range(low, high, open_low=open_low, infinite=infinite)}


def ranged(value: Range | None) -> dict[str, Range | None]:
    """A field's metadata, for a range of any kind; None: its numbers are not looked at."""
    return {"range": value}


def no_leaf(tree: Any) -> bool:
    """That no tuple or list is one array."""
    return False


def ranges_of(
    tree: Any, where: str = "", given: Range | None = NOT_NAN, is_leaf: Callable[[Any], bool] = no_leaf
) -> Iterator[tuple[str, Any, Range]]:
    """(name, value, range) of all numbers in a tree of dataclasses, tuples and dictionaries; none of flags and keys.

    Names are those by which Python reaches them, `rigid.mass` or `joints["point rigid-world"].compliance`, behind
    `where`. `given`: of numbers that declare none, found in a field that does. `is_leaf`: of tuples that are one array.
    """
    if tree is None or given is None:
        return
    if dataclasses.is_dataclass(tree):
        for field in dataclasses.fields(tree):
            if not field.metadata.get("static"):
                name = f"{where}.{field.name}" if where else field.name
                yield from ranges_of(getattr(tree, field.name), name, field.metadata.get("range", NOT_NAN), is_leaf)
    elif isinstance(tree, Mapping):
        for key, value in tree.items():
            yield from ranges_of(value, f'{where}["{key}"]', given, is_leaf)
    elif isinstance(tree, tuple | list) and not is_leaf(tree):
        for number, value in enumerate(tree):
            yield from ranges_of(value, f"{where}[{number}]", given, is_leaf)
    elif not is_key(tree) and getattr(tree, "dtype", None) != np.dtype(bool):
        yield where, tree, given
