"""Dual route: MPRGP on the impulses of all rows, as in Benevolensky & Voroshilov 2009, section 3."""

import jax
import jax.numpy as jnp

from jaxfem.solvers.mprgp import mprgp_loop
from jaxfem.solvers.status import SolveInfo
from jaxfem.system.soft import System

Array = jax.Array
Impulses = tuple[Array, ...]


def solve_dual(system: System, guess: Impulses) -> tuple[Array, tuple[SolveInfo, Impulses]]:
    """End-of-step velocities (n, 3), info and impulses; `guess`: impulses to start from (those of the last step).

    min 1/2 lam' A lam - b' lam over the bounds, with A = J M^-1 J' + C and b = c - J v*; then v = v* + M^-1 J' lam.
    Fixed nodes have no inverse mass.
    """
    stack = system.rows
    inverse_mass = system.free / system.mass

    def push(impulses: Impulses) -> Array:
        parts = (rows.apply_transpose(lam) for rows, lam in zip(stack, impulses, strict=True))
        return inverse_mass[:, None] * sum(parts, start=jnp.zeros_like(system.target))

    def operator(impulses: Impulses) -> Impulses:
        velocities = push(impulses)
        return tuple(rows.apply(velocities) + rows.compliance * lam for rows, lam in zip(stack, impulses, strict=True))

    impulses, info = mprgp_loop(
        operator,
        tuple(rows.bias - rows.apply(system.target) for rows in stack),
        tuple(None if rows.bounds is None else rows.bounds[0] for rows in stack),
        tuple(None if rows.bounds is None else rows.bounds[1] for rows in stack),
        x0=guess,
        diagonal=tuple(rows.diagonal(inverse_mass) + rows.compliance for rows in stack),
        tol=system.tolerance,
        max_iterations=system.max_iterations,
    )
    return (system.target + push(impulses)) * system.free[:, None], (info, impulses)
