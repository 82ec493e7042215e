"""MPRGP on the impulses of all rows, as in Benevolensky & Voroshilov 2009, section 3."""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxfem.elements.mass import is_diagonal
from jaxfem.methods.allrows.condition import Found, solve_rows
from jaxfem.methods.allrows.operator import RowOperator, row_operator, velocities_from
from jaxfem.methods.allrows.resolved import LONG, elastic_share, with_resolution
from jaxfem.methods.allrows.rounds import with_friction
from jaxfem.methods.base import Facts, Solved
from jaxfem.methods.by_rows import Impulses, RowMethod
from jaxfem.methods.nodes.condensed import coarse_of
from jaxfem.methods.nodes.method import PairCondition, Prepared, VelocityCondition, solve_on_velocities
from jaxfem.model import Model, Params, State
from jaxfem.rows.bounds import Bounds, named, sides_of
from jaxfem.solvers.implicit import implicit_solution
from jaxfem.solvers.mprgp import mprgp_loop
from jaxfem.solvers.status import SolveInfo
from jaxfem.system.soft import System, merged, step_system

Array = jax.Array

ROUNDING = 4.0
"""Times the precision and the size of the impulses: residuals of the rows have no digits below. They are seen to round
to 1: asked for that, a solve ends by luck, after 600 iterations or 20,000 (ten tonnes on a gram)."""
LIGHT = 0.03
"""Times the root of the lightest mass over the heaviest: the loosest tolerance. Residuals are measured in energy, of
which grams that carry a tonne have next to none: to a looser one they fly off, or sink into the ground."""


class Mprgp(RowMethod):
    """Modified proportioning with reduced gradient projections on all rows; friction in a pyramid. For any scene."""

    name: ClassVar[str] = "mprgp"
    guarded: ClassVar[bool] = False

    def refuses(self, facts: Facts) -> str | None:
        """Masses that have no simple inverse."""
        if not is_diagonal(facts.mass):
            return f'needs the inverse of the masses, so mass = "lumped", not "{facts.mass}"'
        return None

    def prepare(self, model: Model, params: Params, state: State, dt: Array) -> Array | None:
        """With soft bodies alone derivatives are solved for on the nodes: that preconditioner's coarse inverse."""
        return None if model.coupled else coarse_of(step_system(model, params, state, dt))

    def solve(self, system: System, plan: Any, cache: Any, velocities: Array, impulses: Impulses | None) -> Solved:
        """All rows at once. With a preconditioner of the nodes, derivatives are those of the condition on them."""
        assert impulses is not None
        if cache is None:
            return solve_rows(system, plan, impulses, MprgpSearch())
        inputs = Prepared(system, cache)
        if not system.extra:
            return solve_on_velocities(_ByImpulses(), inputs, impulses)
        condition = _PairByImpulses(symmetric=not system.friction)
        (unknown, _), (info, found) = implicit_solution(condition, inputs, impulses)
        return Solved(merged(system, unknown), found, info)

    def round(
        self, system: System, cache: Any, velocities: Array, impulses: Impulses | None, target: Array
    ) -> tuple[Solved, Array]:
        """One solve. Its tolerance is one of the rows' own residual: where that holds at once, the rounds end."""
        assert impulses is not None
        (unknown, found), info = _searched(system, impulses)
        return Solved(unknown, found, info), info.iterations == 0


@dataclasses.dataclass(frozen=True)
class MprgpSearch:
    """Rounds of MPRGP, until friction's bounds settle."""

    cone: ClassVar[bool] = False

    def found(self, system: System, plan: Any, operator: RowOperator, guess: Impulses) -> Found:
        """Impulses and their sides."""
        system = system.replace(tolerance=jnp.minimum(system.tolerance, _loosest(system, operator)))

        def once(start: Impulses, bounds: Bounds, limit: Array) -> Found:
            found, info = mprgp_loop(
                operator.apply,
                operator.right,
                *bounds,
                x0=start,
                diagonal=operator.diagonal,
                tol=system.tolerance,
                max_iterations=limit,
                rounding=ROUNDING * jnp.finfo(system.target.dtype).eps,
            )
            return Found(found, sides_of(bounds, found), info)

        return with_resolution(system, operator, with_friction(system, operator, guess, once, rounded=True))


def _loosest(system: System, operator: RowOperator) -> Array:
    """See `LIGHT` and `LONG`; in single precision no tighter than what can be reached."""
    rigid = 0 if system.inertia is None else system.inertia.shape[0]
    last = system.mass.shape[0] - rigid  # masses of linear triples; those of angular ones follow
    mass, free = system.mass[:last], system.free[:last] > 0
    heavy = jnp.max(jnp.where(free, mass, 0))
    share = jnp.min(jnp.where(free, mass, jnp.inf)) / jnp.where(heavy > 0, heavy, 1)
    loosest = jnp.minimum(LIGHT * jnp.sqrt(share), LONG * elastic_share(system, operator))
    reached: Array = jnp.maximum(loosest, 100 * jnp.finfo(mass.dtype).eps)
    return reached


@dataclasses.dataclass(frozen=True)
class _ByImpulses(VelocityCondition):
    """The condition on the nodes, solved by way of the impulses."""

    def solve(self, inputs: Prepared, guess: Impulses) -> tuple[Array, Any]:
        """From the last impulses."""
        (unknown, impulses), info = _searched(inputs.system, guess)
        return unknown, (info, impulses)


@dataclasses.dataclass(frozen=True)
class _PairByImpulses(PairCondition):
    """The condition on the nodes and the extra rows' impulses, solved by way of all impulses."""

    def solve(self, inputs: Prepared, guess: Any) -> tuple[Any, Any]:
        """From the last impulses."""
        (unknown, impulses), info = _searched(inputs.system, guess)
        extra = named(inputs.system.extra, (impulses[name] for name in inputs.system.extra))
        return (unknown, extra), (info, impulses)


def _searched(system: System, guess: Impulses) -> tuple[tuple[Array, Impulses], SolveInfo]:
    """Velocities of the free nodes (n, 3) and impulses; and info."""
    found = MprgpSearch().found(system, None, row_operator(system), guess)
    return (velocities_from(system, found.impulses) * system.free[:, None], found.impulses), found.info
