"""The solution of a step, by whichever route, with the derivative that the step's condition implies."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.methods.allrows.dual import solve_dual
from jaxfem.methods.nodes.bounded import pair_gradient, solve_bounded, solve_pair_tangent
from jaxfem.methods.nodes.condensed import solve_condensed, solve_linear
from jaxfem.solvers.implicit import implicit_solution, or_nan, unless_zero
from jaxfem.solvers.status import SolveInfo
from jaxfem.system.soft import System, extra_rows, merged, momentum_gradient

Array = jax.Array


def solve_system(system: System, route: str, velocities: Array, impulses: Any) -> tuple[Array, Any, SolveInfo]:
    """End-of-step velocities (n, 3) of all nodes, impulses and info; differentiable in the system.

    `velocities`, `impulses`: the last step's, to start from. "mprgp" needs impulses for all rows; "condensed" may have
    them for the extra rows, or None. What comes back is of the same structure.
    """
    if not extra_rows(system):
        guess = impulses if route == "mprgp" else velocities
        unknown, (info, found) = implicit_solution(_Velocities(route), system, guess)
        return merged(system, unknown), found, info
    (unknown, own), (info, found) = implicit_solution(_Pair(route, not system.friction), system, (velocities, impulses))
    if route == "condensed" and impulses is not None:
        found = own
    return merged(system, unknown), found, info


@dataclasses.dataclass(frozen=True)
class _Velocities:
    """The condition where all rows are elastic; equal ones share a program. The unknown: velocities of free nodes."""

    route: str
    symmetric: bool = True

    def gradient(self, system: System, unknown: Array) -> Array:
        return momentum_gradient(system, unknown)

    def solve(self, system: System, guess: Any) -> tuple[Array, Any]:
        return (solve_dual if self.route == "mprgp" else solve_condensed)(system, guess)

    def tangent_solve(self, system: System, unknown: Array, right: Array, matvec: Any) -> Array:
        return or_nan(*unless_zero(solve_linear, system, right))


@dataclasses.dataclass(frozen=True)
class _Pair:
    """The condition with extra rows. The unknown: velocities of free nodes, and the extra rows' impulses."""

    route: str
    symmetric: bool = True

    def gradient(self, system: System, unknown: Any) -> Any:
        return pair_gradient(system, unknown)

    def solve(self, system: System, guess: Any) -> tuple[Any, Any]:
        velocities, impulses = guess
        if self.route == "mprgp":
            velocities, (info, impulses) = solve_dual(system, impulses)
            return (velocities, impulses[len(impulses) - len(extra_rows(system)) :]), (info, impulses)
        if impulses is None:
            impulses = tuple(jnp.zeros_like(rows.bias) for rows in extra_rows(system))
        found, info = solve_bounded(system, (velocities, impulses))
        return found, (info, None)

    def tangent_solve(self, system: System, unknown: Any, right: Any, matvec: Any) -> Any:
        return solve_pair_tangent(system, unknown, right, matvec)
