"""The condensed method: elastic rows eliminated onto the nodes; other rows keep their impulses as unknowns beside."""

import dataclasses
from collections import OrderedDict
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxfem.methods.base import METHODS, Facts, Solved
from jaxfem.methods.by_rows import Impulses, RowMethod
from jaxfem.methods.nodes.bounded import pair_gradient, solve_bounded, solve_pair_tangent
from jaxfem.methods.nodes.condensed import coarse_of, linearised, solve_condensed, solve_linear
from jaxfem.methods.nodes.rounds import solve_in_rounds
from jaxfem.model import Model, Params, State
from jaxfem.pytrees import Pytree
from jaxfem.rows.base import Rows
from jaxfem.solvers.implicit import implicit_solution, or_nan, unless_zero
from jaxfem.solvers.status import SolveInfo
from jaxfem.system.soft import System, merged, momentum_gradient, step_system

Array = jax.Array

FIRST_DIGITS = 1e-3  # a round need not be solved to more than the next one will correct


class Prepared(Pytree):
    """A step's system beside the preconditioner's `coarse` inverse: what the conditions below are solved from."""

    system: System
    coarse: Array


class Condensed(RowMethod):
    """Conjugate gradients on the nodes (see `condensed.py`); with extra rows a semismooth Newton method around them
    (see `bounded.py`), and Newton's around both where a law is not linear (see `rounds.py`). For scenes with soft
    bodies."""

    name: ClassVar[str] = "condensed"
    nonlinear: ClassVar[bool] = True
    guarded: ClassVar[bool] = True
    as_it_is: ClassVar[bool] = True

    def refuses(self, facts: Facts) -> str | None:
        """Scenes without soft bodies, and those whose rigid bodies nothing ties to anything."""
        if not facts.soft:
            return 'works on the nodes of soft bodies, and this scene has none: use "auto", "direct" or "mprgp"'
        if facts.rigid and not facts.tied:
            return 'takes rigid bodies that joints or contacts tie, and this scene has neither: use "auto" or "mprgp"'
        return None

    def prepare(self, model: Model, params: Params, state: State, dt: Array) -> Array:
        """The preconditioner's coarse inverse. It turns with the body, so one serves many steps."""
        return coarse_of(step_system(model, params, state, dt))

    def start(self, model: Model, params: Params, state: State) -> Impulses | None:
        """Zero impulses of the rows that are not elastic; None where there are none."""
        return super().start(model, params, state) or None

    def solved_rows(self, system: System) -> OrderedDict[str, Rows]:
        """All but the elastic ones."""
        return OrderedDict(system.extra)

    def solve(self, system: System, plan: Any, cache: Any, velocities: Array, impulses: Impulses | None) -> Solved:
        """On velocities alone where all rows are elastic, else on velocities and impulses."""
        inputs = Prepared(system, cache)
        if not system.extra or impulses is None:
            return solve_on_velocities(VelocityCondition(), inputs, velocities)
        condition = PairCondition(symmetric=not system.friction)
        (unknown, found), info = implicit_solution(condition, inputs, (velocities, impulses))
        return Solved(merged(system, unknown), found, info)

    def round(
        self, system: System, cache: Any, velocities: Array, impulses: Impulses | None, target: Array
    ) -> tuple[Solved, Array]:
        """One solve, to no more digits than the next one will leave."""
        loose = system.replace(tolerance=jnp.maximum(system.tolerance, FIRST_DIGITS), floor=0.3 * target)
        found, info = solve_condensed(loose, cache, velocities)
        return Solved(found, None, info), jnp.bool_(False)


def solve_on_velocities(condition: "VelocityCondition", inputs: Prepared, guess: Any) -> Solved:
    """A step whose rows are all elastic, by a condition on the velocities of its free nodes."""
    unknown, (info, impulses) = implicit_solution(condition, inputs, guess)
    return Solved(merged(inputs.system, unknown), impulses, info)


@dataclasses.dataclass(frozen=True)
class VelocityCondition:
    """The condition where all rows are elastic; equal ones share a program. The unknown: velocities of free nodes."""

    symmetric: bool = True

    def gradient(self, inputs: Prepared, unknown: Array) -> Array:
        """Of the primal objective."""
        return momentum_gradient(inputs.system, unknown)

    def solve(self, inputs: Prepared, guess: Any) -> tuple[Array, Any]:
        """From the last velocities; no impulses are formed."""
        if inputs.system.nonlinear:
            (unknown, _), info = solve_in_rounds(inputs.system, inputs.coarse, (guess, None))
            return unknown, (info, None)
        unknown, info = solve_condensed(inputs.system, inputs.coarse, guess)
        return unknown, (info, None)

    def tangent_solve(self, inputs: Prepared, unknown: Array, right: Array, matvec: Any) -> Array:
        """With the same matrix, whatever way the solution was found."""

        def solve(given: tuple[Prepared, Array], right: Array) -> tuple[Array, SolveInfo]:
            inputs, unknown = given
            return solve_linear(linearised(inputs.system, merged(inputs.system, unknown)), inputs.coarse, right)

        return or_nan(*unless_zero(solve, (inputs, unknown), right))


@dataclasses.dataclass(frozen=True)
class PairCondition:
    """The condition with extra rows. The unknown: velocities of free nodes, and the extra rows' impulses."""

    symmetric: bool = True

    def gradient(self, inputs: Prepared, unknown: Any) -> Any:
        """See `bounded.py`."""
        return pair_gradient(inputs.system, unknown)

    def solve(self, inputs: Prepared, guess: Any) -> tuple[Any, Any]:
        """From the last velocities and impulses."""
        if inputs.system.nonlinear:
            return solve_in_rounds(inputs.system, inputs.coarse, guess)
        return solve_bounded(inputs.system, inputs.coarse, guess)

    def tangent_solve(self, inputs: Prepared, unknown: Any, right: Any, matvec: Any) -> Any:
        """With the rows at a bound held there."""
        nonlinear = inputs.system.nonlinear
        system = linearised(inputs.system, merged(inputs.system, unknown[0]), 1)
        return solve_pair_tangent(system, inputs.coarse, unknown, right, matvec, iterate=nonlinear)


METHODS.add("corotated", Condensed)  # its word where methods are compared that turn with the body in other ways
