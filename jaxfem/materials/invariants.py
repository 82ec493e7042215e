"""Invariants of a deformation gradient F = I + H, from H: near the undeformed shape no digits cancel.

What laws are made of: |F|^2, |cof F|^2 and J = det F, each less its value at F = I; and the same of F / J^(1/3), which
tell shape from volume (Flory 1961).
"""

import jax
import jax.numpy as jnp

from jaxfem.tensors import Matrix3, determinant

Array = jax.Array

FLAT = 0.25
"""The J below which powers of it go on as parabolas: laws of silicones stay finite where elements turn inside out."""


def volume_change(h: Matrix3) -> Array:
    """J - 1."""
    return _trace(h) + _second(h) + determinant(h)


def first_invariant(h: Matrix3) -> Array:
    """|F|^2 - 3 = 2 tr H + |H|^2."""
    return 2 * _trace(h) + _squares(h)


def second_invariant(h: Matrix3) -> Array:
    """|cof F|^2 - 3, which is (I1^2 - tr (F'F)^2) / 2 - 3, by E = F'F - I: 2 tr E + ((tr E)^2 - |E|^2) / 2."""
    e = [[h[i][j] + h[j][i] + sum(h[k][i] * h[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    trace = _trace(e)
    return 2 * trace + 0.5 * (trace * trace - _squares(e))


def power_change(change: Array, exponent: float) -> Array:
    """J^exponent - 1 of `change` J - 1; below J = `FLAT` the parabola that goes on with the same value and slopes."""
    flat = change < FLAT - 1
    ordinary = jnp.expm1(exponent * jnp.log1p(jnp.where(flat, 0.0, change)))
    value, below = FLAT**exponent, change + (1 - FLAT)
    slope, bend = exponent * value / FLAT, exponent * (exponent - 1) * value / FLAT**2
    return jnp.where(flat, (value - 1) + below * (slope + 0.5 * bend * below), ordinary)


def first_of_shape(h: Matrix3) -> Array:
    """|F|^2 / J^(2/3) - 3, 0 where nothing but the volume has changed."""
    scale = power_change(volume_change(h), -2 / 3)
    return first_invariant(h) * (1 + scale) + 3 * scale


def second_of_shape(h: Matrix3) -> Array:
    """|cof F|^2 / J^(4/3) - 3."""
    scale = power_change(volume_change(h), -4 / 3)
    return second_invariant(h) * (1 + scale) + 3 * scale


def _trace(a: Matrix3) -> Array:
    return a[0][0] + a[1][1] + a[2][2]


def _second(a: Matrix3) -> Array:
    """The second invariant of a matrix, the sum of its principal minors."""
    pairs = ((0, 1), (0, 2), (1, 2))
    found: Array = sum((a[i][i] * a[j][j] - a[i][j] * a[j][i] for i, j in pairs), start=jnp.zeros_like(a[0][0]))
    return found


def _squares(a: Matrix3) -> Array:
    return sum((a[i][j] * a[i][j] for i in range(3) for j in range(3)), start=jnp.zeros_like(a[0][0]))
