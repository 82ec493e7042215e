"""The rows' own matrix A = J M^-1 J' + C, as a product, with its right-hand side and its diagonal."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree
from jaxfem.rows.bounds import Impulses, named
from jaxfem.rows.points import pushes, rates
from jaxfem.system.coupled import apply_inverse_mass
from jaxfem.system.soft import System, inverse_mass

Array = jax.Array


class RowOperator(Pytree):
    """A as a product (`apply`), b = c - J v* (`right`) and A's `diagonal`, by group."""

    system: System
    inverse: tuple[Array, Array | None]
    right: Impulses
    diagonal: Impulses

    def apply(self, impulses: Impulses) -> Impulses:
        """A lam."""
        found = rates_of(self.system, apply_inverse_mass(self.inverse, pushed(self.system, impulses)))
        rows = self.system.rows
        return named(rows, (found[n] + each.compliance * impulses[n] for n, each in rows.items()))


def row_operator(system: System) -> RowOperator:
    """The operator of a step's rows."""
    inverse, rows = inverse_mass(system), system.rows
    before = rates_of(system, system.target)
    right = named(rows, (each.bias - before[name] for name, each in rows.items()))
    diagonal = named(rows, (_diagonal(each, inverse) + each.compliance for each in rows.values()))
    return RowOperator(system, inverse, right, diagonal)


def pushed(system: System, impulses: Impulses) -> Array:
    """J' lam of all rows, (n, 3)."""
    parts = [rows.apply_transpose(impulses[name]) for name, rows in system.rows.items() if name not in system.extra]
    return sum(parts, start=pushes(system.extra, impulses) if system.extra else jnp.zeros_like(system.target))


def rates_of(system: System, velocities: Array) -> Impulses:
    """J v of all rows, of velocities (n, 3)."""
    beside = rates(system.extra, velocities) if system.extra else {}
    return named(system.rows, (beside[n] if n in beside else rows.apply(velocities) for n, rows in system.rows.items()))


def velocities_from(system: System, impulses: Impulses) -> Array:
    """v* + M^-1 J' lam, (n, 3)."""
    velocities = system.target + apply_inverse_mass(inverse_mass(system), pushed(system, impulses))
    return jnp.where(system.free[:, None] > 0, velocities, system.prescribed)


def _diagonal(rows: Any, inverse: tuple[Array, Array | None]) -> Array:
    diagonal: Array = rows.diagonal(*inverse) if hasattr(rows, "triples") else rows.diagonal(inverse[0])
    return diagonal
