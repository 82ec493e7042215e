"""Isotropic linear elasticity: constants from Young's modulus and Poisson's ratio, and what values are refused."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Array = jax.Array


class MaterialError(ValueError):
    """A material value outside its admissible range."""


def shear_modulus(young: Array, poisson: Array) -> Array:
    """Second Lame constant mu = E / (2 (1 + nu)) [Pa]."""
    return young / (2 * (1 + poisson))


def bulk_modulus(young: Array, poisson: Array) -> Array:
    """K = E / (3 (1 - 2 nu)) [Pa]."""
    return young / (3 * (1 - 2 * poisson))


def lame(young: Array, poisson: Array) -> tuple[Array, Array]:
    """First and second Lame constants (lambda, mu) [Pa]."""
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), shear_modulus(young, poisson)


def eigenstiffness(young: Array, poisson: Array) -> tuple[Array, Array]:
    """The two distinct eigenvalues of the isotropic stiffness in the Kelvin-Mandel basis, (3K, 2 mu) [Pa]."""
    return 3 * bulk_modulus(young, poisson), 2 * shear_modulus(young, poisson)


_RANGES = {
    "young": (lambda v: v > 0, "must be > 0 Pa (soft silicone: 1e5, steel: 2e11)"),
    "poisson": (
        lambda v: (v > -1) & (v < 0.5),
        "must lie strictly between -1 and 0.5; for a nearly incompressible material use 0.49 or 0.499",
    ),
    "density": (lambda v: v > 0, "must be > 0 kg/m^3 (water: 1000)"),
    "damping": (lambda v: v >= 0, "must be >= 0; it is the time beta in seconds of C = beta K, typically 1e-4 to 1e-2"),
}

# Beyond these a unit slip (MPa for Pa, g/cm^3 for kg/m^3, percent for seconds) is likelier than a material.
_PLAUSIBLE = {"young": (1e0, 1e13), "density": (1e-1, 1e5), "damping": (0.0, 10.0)}


def check_material(body: str, name: str, value: Any, elements: int) -> np.ndarray:
    """Validate one material value of a body on the host.

    `value` is a scalar or one number an element; returns a float64 array of shape () or (elements,). Raises
    `MaterialError` naming the body, the element, the value and the remedy.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (elements,)):
        raise MaterialError(
            f'{name} of "{body}" has shape {array.shape}; give one number, or one for each of its {elements} elements'
        )
    admissible, advice = _RANGES[name]
    bad = np.flatnonzero(~(np.isfinite(array) & admissible(array)))
    if bad.size:
        where = f" of element {bad[0]}" if array.shape else ""
        raise MaterialError(f'{name}{where} of "{body}" is {np.atleast_1d(array)[bad[0]]:g}: it {advice}')
    low, high = _PLAUSIBLE.get(name, (-np.inf, np.inf))
    if array.min() < low or array.max() > high:
        raise MaterialError(
            f'{name} of "{body}" is {array.min():g} to {array.max():g}, outside the plausible {low:g} to {high:g} in '
            "SI units (Pa, kg/m^3, s): check its unit"
        )
    return array


def critical_damping(frequency: Array) -> Array:
    """The beta [s] that damps a mode of `frequency` [Hz] critically: damping ratio beta omega / 2 = 1."""
    return 1 / (jnp.pi * frequency)
