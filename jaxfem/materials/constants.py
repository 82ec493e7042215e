"""A material constant as a law declares it: all that scene files, checks, fits, plots and messages know of it."""

import dataclasses
import keyword
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import FLAG, INTERVAL, NUMBER, TEXT, Wanted, flaw_of, is_number
from jaxfem.ranges import Range

Array = jax.Array


class MaterialError(ValueError):
    """A material value outside its admissible range, or one that is missing or strange to its law."""


@dataclasses.dataclass(frozen=True)
class Transform:
    """How a fit's unknown z becomes a value in the open range (low, high).

    `proportional`: several values change in proportion, and plots take a logarithmic axis. `open_spread`: the standard
    error of z from which samples say next to nothing of the value. `longest`: step of z that a search may take at once.
    """

    low: float = -float("inf")
    high: float = float("inf")
    proportional: ClassVar[bool] = False
    open_spread: ClassVar[float] = float("inf")
    longest: ClassVar[float] = 1.0

    def value(self, z: Array) -> Array:
        """The value at z."""
        raise NotImplementedError

    def unknown(self, value: float) -> float:
        """The z of a value."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class Logarithm(Transform):
    """z = log of a positive value: a step of z is a factor, whatever the value's size."""

    low: float = 0.0
    proportional: ClassVar[bool] = True
    open_spread: ClassVar[float] = 0.5

    def value(self, z: Array) -> Array:
        """exp z."""
        return jnp.exp(z)

    def unknown(self, value: float) -> float:
        """log of the value."""
        return float(np.log(value))


@dataclasses.dataclass(frozen=True)
class Logistic(Transform):
    """A value on the logistic curve between open bounds: no step of z leaves them."""

    open_spread: ClassVar[float] = 1.0

    def value(self, z: Array) -> Array:
        """The curve at z."""
        return self.low + (self.high - self.low) * jax.nn.sigmoid(z)

    def unknown(self, value: float) -> float:
        """Log of the odds of the value's share of the range."""
        share = (value - self.low) / (self.high - self.low)
        return float(np.log(share) - np.log1p(-share))


@dataclasses.dataclass(frozen=True)
class Identity(Transform):
    """The value itself."""

    longest: ClassVar[float] = float("inf")

    def value(self, z: Array) -> Array:
        """z."""
        return z

    def unknown(self, value: float) -> float:
        """The value."""
        return float(value)


@dataclasses.dataclass(frozen=True)
class Signed(Transform):
    """A value of either sign, `size` sinh z: a step of z is a factor far from zero, and of about `size` near it."""

    size: float = 1.0

    def value(self, z: Array) -> Array:
        """size sinh z."""
        return self.size * jnp.sinh(z)

    def unknown(self, value: float) -> float:
        """Its inverse."""
        return float(np.arcsinh(value / self.size))


@dataclasses.dataclass(frozen=True)
class Constant:
    """One constant of a law. Static: no arrays.

    `name`: its word in Python, scene files and fits; `label`: in plots and prose; `unit`: SI, "" for none. Admissible
    are finite values strictly between `low` and `high`, with `closed` `low` itself too; `advice` ends the sentence
    that refuses others. Outside `plausible` a slip of units (MPa for Pa, percent for a share) is likelier than a
    material. `default`: None where a value must be given.
    Fits: `transform`; `bounds` where a user gives none: multiples of the start, or with `absolute` the values
    themselves; `stiffness`: a body's stiffness is in proportion to it, and a fit scans over it; `viscous`: it is a
    time [s] of viscous stress, to which a time scheme's damping adds; `doubt`: a value below which a fit is warned, and
    why; `limit`: samples may tell no more than that it is large, or small: its 95 % interval is then that of the
    profile likelihood, open towards one side.
    """

    name: str
    unit: str
    advice: str
    label: str = ""
    low: float = -float("inf")
    high: float = float("inf")
    closed: bool = False
    plausible: tuple[float, float] = (-float("inf"), float("inf"))
    default: float | None = None
    transform: Transform = Logarithm()
    bounds: tuple[float, float] = (1e-3, 1e3)
    absolute: bool = False
    stiffness: bool = False
    viscous: bool = False
    doubt: tuple[float, str] | None = None
    limit: bool = False

    def __post_init__(self) -> None:
        self._check_name()
        if flaw := flaw_of(self, DECLARED):
            raise TypeError(f"the constant {self.name!r} has {flaw}")
        if not self.low < self.high:
            raise TypeError(f"{self.name} must lie between {self.low:g} and {self.high:g}: give low < high")
        if self.default is not None and not self._inside(np.asarray(self.default)):
            raise TypeError(f"the default of {self.name} is {self.default:g}, but it {self.advice}")
        if isinstance(self.transform, Logarithm) and self.low < 0 and np.isfinite(self.low):
            raise TypeError(
                f"{self.name} may be negative, but fits search its logarithm: give transform=Identity(), or low=0"
            )

    def _check_name(self) -> None:
        plain = isinstance(self.name, str) and self.name.isidentifier()
        if not plain or self.name.startswith("_") or keyword.iskeyword(self.name):
            raise TypeError(f"a constant is named {self.name!r}; its name must be a plain Python name, like 'young'")

    @property
    def range(self) -> Range:
        """Its admissible values, as compiled functions look at them."""
        return Range(self.low, self.high, open_low=not self.closed, open_high=True, advice=self.advice)

    @property
    def title(self) -> str:
        """The constant in prose."""
        return self.label or self.name

    def _inside(self, array: np.ndarray) -> Any:
        return ((array >= self.low) if self.closed else (array > self.low)) & (array < self.high)

    def _numbers(self, body: str, value: Any) -> np.ndarray:
        """The value as float64; MaterialError where it is no real number, or numbers of no one shape."""
        try:
            array = np.asarray(value)
        except ValueError:  # rows of several lengths
            array = np.asarray(None)
        if array.dtype.kind not in "iuf":
            shown = repr(value) if len(repr(value)) <= 60 else type(value).__name__
            raise MaterialError(
                f'{self.name} of "{body}" is {shown}: give one number, or one an element'
                + (f", in {self.unit}" if self.unit else "")
            )
        return array.astype(np.float64)

    def checked(self, body: str, value: Any, elements: int) -> np.ndarray:
        """Validate a body's value on the host: one number, or one for each of its `elements`.

        Returns float64 of shape () or (elements,). MaterialError names the body, the element, the value, the remedy.
        """
        array = self._numbers(body, value)
        if array.shape not in ((), (elements,)):
            raise MaterialError(
                f'{self.name} of "{body}" has shape {array.shape}; give one number, or one for each of its {elements} '
                "elements"
            )
        bad = np.flatnonzero(~(np.isfinite(array) & self._inside(array)))
        if bad.size:
            where = f" of element {bad[0]}" if array.shape else ""
            raise MaterialError(f'{self.name}{where} of "{body}" is {np.atleast_1d(array)[bad[0]]:g}: it {self.advice}')
        low, high = self.plausible
        if array.min() < low or array.max() > high:
            raise MaterialError(
                f'{self.name} of "{body}" is {array.min():g} to {array.max():g}, outside the plausible {low:g} to '
                f"{high:g} in SI units (Pa, kg/m^3, s): check its unit"
            )
        return array


def _is_doubt(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and is_number(value[0]) and isinstance(value[1], str)


DECLARED = {
    **dict.fromkeys(("unit", "advice", "label"), TEXT),
    **dict.fromkeys(("low", "high"), NUMBER),
    **dict.fromkeys(("plausible", "bounds"), INTERVAL),
    **dict.fromkeys(("closed", "absolute", "stiffness", "viscous", "limit"), FLAG),
    "default": Wanted("a number, or None where a value must be given", lambda v: v is None or is_number(v)),
    "transform": Wanted("a Transform, like Logarithm() or Identity()", lambda v: isinstance(v, Transform)),
    "doubt": Wanted("a number and a text, or None", lambda v: v is None or _is_doubt(v)),
}
"""What a constant says of itself."""

DENSITY = Constant(
    "density", "kg/m^3", "must be > 0 kg/m^3 (water: 1000)", label="density", low=0.0, plausible=(1e-1, 1e5)
)
"""The one constant that every soft body has beside those of its law."""

MASS_DAMPING = Constant(
    "mass_damping",
    "1/s",
    "must be >= 0; it is the rate alpha in 1/s of C = alpha M, typically 0.1 to 10",
    label="mass-proportional damping",
    low=0.0,
    closed=True,
    plausible=(0.0, 1e4),
    bounds=(1e-3, 1e3),
)
"""Of bodies that give it; scenes without such a body know no such constant, and compile none."""
