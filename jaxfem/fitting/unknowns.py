"""Unknowns of a fit: each a free number z, with the transform to its physical value and its bounds."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.model import Params

Array = jax.Array

UNITS = {"young": "Pa", "poisson": "", "damping": "s", "density": "kg/m^3", "delay": "s"}
POISSON = (-1.0, 0.5)


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """`names`, in the order of the fit, with `lower` and `upper` bounds (P,) of their physical values."""

    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray

    def free(self, values: Mapping[str, float]) -> np.ndarray:
        """z (P,) of physical values, moved inside the bounds."""
        inside = np.clip([values[name] for name in self.names], self.lower, self.upper)
        return np.array([_free(name, value) for name, value in zip(self.names, inside, strict=True)])

    def values(self, z: Any) -> dict[str, float]:
        """Physical values of z (P,)."""
        return {name: float(physical(name, jnp.asarray(each))) for name, each in zip(self.names, z, strict=True)}

    def slopes(self, z: Any) -> np.ndarray:
        """d value / d z (P,)."""
        return np.array(
            [float(jax.grad(lambda u, n=name: physical(n, u))(float(e))) for name, e in zip(self.names, z, strict=True)]
        )

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of z, (P,) each."""
        low = np.array([_free(n, v) for n, v in zip(self.names, self.lower, strict=True)])
        return low, np.array([_free(n, v) for n, v in zip(self.names, self.upper, strict=True)])


def physical(name: str, z: Array) -> Array:
    """Value of a free number: its exponential; Poisson's ratio a logistic curve on (-1, 0.5); the delay itself."""
    if name == "poisson":
        return POISSON[0] + (POISSON[1] - POISSON[0]) * jax.nn.sigmoid(z)
    return z if name == "delay" else jnp.exp(z)


def _free(name: str, value: float) -> float:
    if name == "poisson":
        share = (value - POISSON[0]) / (POISSON[1] - POISSON[0])
        return float(np.log(share) - np.log1p(-share))
    return float(value if name == "delay" else np.log(value))


def with_values(params: Params, values: Mapping[str, Array]) -> Params:
    """Params with material values replaced; an array of several keeps its proportions and gets the value as its mean
    (all zero: the value throughout)."""
    changed = {}
    for name, value in values.items():
        old = getattr(params, name)
        if jnp.ndim(old) == 0 or name == "poisson":
            changed[name] = jnp.broadcast_to(value, jnp.shape(old)).astype(old.dtype)
        else:
            mean = jnp.mean(old)
            shares = jnp.where(mean == 0, 1.0, old / jnp.where(mean == 0, 1.0, mean))
            changed[name] = (shares * value).astype(old.dtype)
    return params.replace(**changed)


def start_values(params: Params, names: Sequence[str], spacing: float) -> dict[str, float]:
    """Values to start from: the scene's own; damping that is zero starts at a tenth of the sample spacing."""
    values = {name: 0.0 if name == "delay" else float(jnp.mean(getattr(params, name))) for name in names}
    if values.get("damping") == 0.0:
        values["damping"] = 0.1 * spacing
    return values


def unknowns(names: Sequence[str], start: Mapping[str, float], bounds: Any, spacing: float) -> Unknowns:
    """Check names and bounds. Bounds not given: a thousand times either way (young, density), ten thousand (damping),
    (-0.95, 0.4995) (poisson), three samples (delay)."""
    names = tuple(names)
    if not names:
        raise FitError(f"no parameter to fit: name some of {', '.join(UNITS)}")
    for name in names:
        if name not in UNITS:
            raise FitError(f'cannot fit "{name}"; known: {", ".join(UNITS)}')
    if len(set(names)) < len(names):
        raise FitError(f"a parameter is named twice: {', '.join(names)}")
    bounds = dict(bounds or {})
    for name in bounds:
        if name not in names:
            raise FitError(f'bounds are given for "{name}", which is not fitted; fitted: {", ".join(names)}')
    pairs = [bounds.get(name) or _usual_bounds(name, start[name], spacing) for name in names]
    for name, pair in zip(names, pairs, strict=True):
        _check_bounds(name, pair)
    low, high = np.array(pairs, dtype=np.float64).T
    return Unknowns(names, low, high)


def _usual_bounds(name: str, start: float, spacing: float) -> tuple[float, float]:
    if name == "poisson":
        return -0.95, 0.4995
    if name == "delay":
        return -3 * spacing, 3 * spacing
    factor = 1e4 if name == "damping" else 1e3
    return start / factor, start * factor


def _check_bounds(name: str, pair: Any) -> None:
    try:
        low, high = (float(value) for value in pair)
    except (TypeError, ValueError):
        raise FitError(f"bounds of {name} are {pair!r}; give two numbers (lowest, highest)") from None
    floor, ceiling = {"poisson": POISSON, "delay": (-np.inf, np.inf)}.get(name, (0.0, np.inf))
    if not floor < low < high < ceiling:
        raise FitError(
            f"bounds of {name} are {low:g} and {high:g}; they must rise and lie between {floor:g} and {ceiling:g}"
        )
