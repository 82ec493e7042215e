"""What every kind of constraint row offers, and what a solver needs of a tuple of them.

A row couples the velocities of a few nodes:  J v + C lam - c  complementary to  lower <= lam <= upper
(Benevolensky & Voroshilov 2009, section 2).  lam is an impulse [N s] for rows in metres a second.
"""

from typing import Protocol

import jax
import jax.numpy as jnp

Array = jax.Array


class Rows(Protocol):
    """Rows of one kind, as a pytree. The arrays of one kind share one shape, called `shape` here."""

    @property
    def compliance(self) -> Array:
        """C > 0, broadcastable to `shape`."""

    @property
    def bias(self) -> Array:
        """c, of `shape`."""

    @property
    def bounds(self) -> tuple[Array, Array] | None:
        """lower and upper, of `shape`; None when no row of this kind has a bound, which then costs nothing."""

    def apply(self, velocities: Array) -> Array:
        """J v: (n, 3) -> `shape`."""

    def apply_transpose(self, impulses: Array) -> Array:
        """J' lam: `shape` -> (n, 3)."""

    def diagonal(self, inverse_mass: Array) -> Array:
        """Diagonal of J M^-1 J' for nodal inverse masses (n,): `shape`."""


def impulses(rows: Rows, velocities: Array) -> Array:
    """The impulses that velocities imply: clip((c - J v) / C, lower, upper)."""
    unbounded = (rows.bias - rows.apply(velocities)) / rows.compliance
    return unbounded if rows.bounds is None else jnp.clip(unbounded, *rows.bounds)
