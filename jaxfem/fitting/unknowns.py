"""Unknowns of a fit: each a number z, with the transform to its physical value and its bounds."""

import dataclasses
import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.materials.constants import DENSITY, Constant, Identity
from jaxfem.model import Params

Array = jax.Array

MOST_LISTED = 24
"""Paths that a message lists."""
MARGIN = 1e-3
"""Of the way from the start to an end of what is admissible: how far usual bounds stay clear of it."""
DELAY = Constant(
    "delay", "s", "must be a time in s", label="delay", transform=Identity(), bounds=(-3.0, 3.0), absolute=True
)
"""The fit's own unknown: the release behind its row. Its usual bounds are in sample spacings."""


def is_delay(constant: Constant) -> bool:
    """Whether it is the release behind its row, of one take or another."""
    return constant.label == DELAY.label and constant.transform == DELAY.transform


def usual_names(constants: Iterable[Constant]) -> tuple[str, ...]:
    """What a fit finds where a user names nothing, of a scene's constants: all but the density, which is weighed."""
    return tuple(each.name for each in constants if each.name != DENSITY.name)


def known_constants(constants: Iterable[Constant]) -> dict[str, Constant]:
    """All that can be fitted, by name, of a scene's constants."""
    return {each.name: each for each in (*constants, DELAY)}


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """`constants`, in the order of the fit, with `lower` and `upper` bounds (P,) of their physical values."""

    constants: tuple[Constant, ...]
    lower: np.ndarray
    upper: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(each.name for each in self.constants)

    @property
    def scanned(self) -> int | None:
        """Which of them a scan runs over: the first that the stiffness is in proportion to; None without."""
        return next((i for i, each in enumerate(self.constants) if each.stiffness), None)

    def unknown(self, values: Mapping[str, float]) -> np.ndarray:
        """z (P,) of physical values, moved inside the bounds."""
        return self._transformed(np.clip([values[name] for name in self.names], self.lower, self.upper))

    def values(self, z: Any) -> dict[str, float]:
        """Physical values of z (P,)."""
        pairs = zip(self.constants, z, strict=True)
        return {each.name: float(each.transform.value(jnp.asarray(number))) for each, number in pairs}

    def slopes(self, z: Any) -> np.ndarray:
        """d value / d z (P,)."""
        pairs = zip(self.constants, z, strict=True)
        return np.array([float(jax.grad(each.transform.value)(float(number))) for each, number in pairs])

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of z, (P,) each."""
        return self._transformed(self.lower), self._transformed(self.upper)

    def _transformed(self, values: Any) -> np.ndarray:
        return np.array([each.transform.unknown(v) for each, v in zip(self.constants, values, strict=True)])


def with_values(params: Params, values: Mapping[str, Array], constants: Iterable[Constant] = ()) -> Params:
    """Params with material values replaced; an array of several keeps its proportions and gets the value as its mean
    (all zero: the value throughout). `constants`: those that are not in proportion get the value throughout."""
    throughout = {each.name for each in constants if not each.transform.proportional}
    changed = {}
    for name, value in values.items():
        old = params.constants[name]
        if jnp.ndim(old) == 0 or name in throughout:
            changed[name] = jnp.broadcast_to(value, jnp.shape(old)).astype(old.dtype)
        else:
            mean = jnp.mean(old)
            shares = jnp.where(mean == 0, 1.0, old / jnp.where(mean == 0, 1.0, mean))
            changed[name] = (shares * value).astype(old.dtype)
    return params.replace(**changed)


def start_value(constant: Constant, value: float, spacing: float) -> float:
    """Where to start from the scene's own value: a positive time that is zero starts at a tenth of the sample spacing,
    and what is at an end of an open range in its middle, since its unknown is infinite at the end."""
    if value == 0.0 and constant.unit == "s" and constant.transform.proportional:
        return 0.1 * spacing
    low, high = constant.transform.low, constant.transform.high
    if np.isfinite(low) and np.isfinite(high) and not low < value < high:
        return (low + high) / 2
    return value


def chosen(names: Sequence[str], known: Mapping[str, Constant]) -> tuple[Constant, ...]:
    """The constants of these names; FitError for none, a strange one, or one named twice."""
    if not names:
        raise FitError(f"no parameter to fit: name some of {_listed(known)}")
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
            hint = f'did you mean "{near[0]}"? ' if near else ""
            hint = _no_group(name, known) or hint
            raise FitError(f'cannot fit "{name}"; {hint}known: {_listed(known)}')
    if len(set(names)) < len(names):
        raise FitError(f"a parameter is named twice: {', '.join(names)}")
    return tuple(known[name] for name in names)


def _no_group(name: str, known: Mapping[str, Constant]) -> str:
    """What to say of a group of a body that has no such elements; nothing where it is something else."""
    body, _, group = name.partition(".")[2].partition(".")
    of = f"{name.partition('.')[0]}.{body}"
    if not group or of not in known:
        return ""
    groups = [each.removeprefix(f"{of}.") for each in known if each.startswith(f"{of}.")]
    there = f"there are {', '.join(groups)}" if groups else "the mesh has none (volumes with names, in a .msh file)"
    return f'"{group}" is no group of elements of "{body}", and groups of nodes or faces have no constants: {there}; '


def _listed(known: Mapping[str, Constant]) -> str:
    """Names, those of materials in full and then some of the paths."""
    plain, paths = [n for n in known if "." not in n], [n for n in known if "." in n]
    more = f" and {len(paths) - MOST_LISTED} more" if len(paths) > MOST_LISTED else ""
    return ", ".join([*plain, *paths[:MOST_LISTED]]) + more


def unknowns(constants: Sequence[Constant], start: Mapping[str, float], bounds: Any, spacing: float) -> Unknowns:
    """Unknowns with checked bounds; those not given are the constants' usual ones."""
    names = [each.name for each in constants]
    bounds = dict(bounds or {})
    for name in bounds:
        if name not in names:
            raise FitError(f'bounds are given for "{name}", which is not fitted; fitted: {", ".join(names)}')
    pairs = [bounds.get(each.name) or _usual_bounds(each, start[each.name], spacing) for each in constants]
    for each, pair in zip(constants, pairs, strict=True):
        _check_bounds(each, pair)
    low, high = np.array(pairs, dtype=np.float64).T
    return Unknowns(tuple(constants), low, high)


def _usual_bounds(constant: Constant, start: float, spacing: float) -> tuple[float, float]:
    low, high = constant.bounds
    if is_delay(constant):
        return spacing * low, spacing * high
    if constant.absolute:
        return low, high
    if not constant.transform.proportional:  # of either sign: about the start
        size = max(abs(start), 1.0) * max(abs(low), abs(high))
        low, high = start - size, start + size
    else:
        low, high = start * low, start * high
    return _admissible(constant, start, low, high)


def _admissible(constant: Constant, start: float, low: float, high: float) -> tuple[float, float]:
    """Usual bounds within what is admissible."""
    ends = constant.low, constant.high
    if low <= ends[0]:
        low = ends[0] + MARGIN * (start - ends[0])
    if high >= ends[1]:
        high = ends[1] - MARGIN * (ends[1] - start)
    return low, high


def _check_bounds(constant: Constant, pair: Any) -> None:
    try:
        low, high = (float(value) for value in pair)
    except (TypeError, ValueError):
        raise FitError(f"bounds of {constant.name} are {pair!r}; give two numbers (lowest, highest)") from None
    floor, ceiling = constant.transform.low, constant.transform.high
    if not floor < low < high < ceiling:
        raise FitError(
            f"bounds of {constant.name} are {low:g} and {high:g}; they must rise and lie between {floor:g} and "
            f"{ceiling:g}"
        )
