"""The rows of rigid bodies by elimination: see `elimination.py` for the search and `order.py` for the order."""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.methods.allrows.condition import Found, solve_rows
from jaxfem.methods.allrows.elimination import search_by_elimination
from jaxfem.methods.allrows.factor import elimination_of
from jaxfem.methods.allrows.flat import flat_rows
from jaxfem.methods.allrows.operator import RowOperator
from jaxfem.methods.allrows.order import RowOrder
from jaxfem.methods.allrows.rounds import with_friction
from jaxfem.methods.base import CannotServe, Facts, Solved
from jaxfem.methods.by_rows import Impulses, RowMethod, first_system
from jaxfem.model import Model, Params, State
from jaxfem.rows.bounds import Bounds, sides_of
from jaxfem.system.coupled import TRACE
from jaxfem.system.soft import System

Array = jax.Array


class Direct(RowMethod):
    """Sparse elimination of all rows, with an active set where some are bounded. For rigid bodies alone."""

    name: ClassVar[str] = "direct"

    def refuses(self, facts: Facts) -> str | None:
        """Scenes with soft bodies."""
        if not facts.coupled:
            return 'is for scenes with rigid bodies, joints or contacts: use "auto" here'
        if facts.soft:
            return 'eliminates the rows of rigid bodies, and this scene has soft bodies: use "auto" or "condensed"'
        return None

    def plan(self, model: Model, params: Params, state: State) -> RowOrder:
        """The order of elimination; CannotServe where nothing ties the bodies, or too much does."""
        assert model.rigid is not None
        # Nothing but these is compiled.
        triples, heights = jax.jit(_triples)(model, params, state)
        order = elimination_of([np.asarray(each) for each in triples], [each.shape[0] for each in heights], model.rigid)
        if order is None:
            raise CannotServe(
                "eliminates the rows that tie rigid bodies, and here there are none, or so many that it is too dear: "
                'use "auto", "mprgp" or "pgs"'
            )
        return order

    def solve(self, system: System, plan: Any, cache: Any, velocities: Array, impulses: Impulses | None) -> Solved:
        """All rows, in the order that the plan says."""
        assert impulses is not None
        return solve_rows(system, plan, impulses, EliminationSearch())


SHARE = 0.1  # of the trace of compliance: tolerance of a round of friction's bounds


@dataclasses.dataclass(frozen=True)
class EliminationSearch:
    """Rounds of elimination, until friction's bounds settle."""

    cone: ClassVar[bool] = False

    def found(self, system: System, plan: Any, operator: RowOperator, guess: Impulses) -> Found:
        """Impulses, their sides, and velocities that know no rounding of impulses that cancel.

        Only their trace of compliance tells how redundant rows, as those at the corners of a box, share what they
        carry. Each round of friction's bounds needs that share, so it is solved for beyond that trace, where the
        precision allows.
        """
        double = system.target.dtype.itemsize > 4
        sharp = jnp.minimum(system.tolerance, SHARE * TRACE[double])
        exact = system.replace(tolerance=sharp) if system.friction and double else system
        rows = flat_rows(exact, operator)

        def once(start: Impulses, bounds: Bounds, limit: Array) -> Found:
            (found, velocities), info = search_by_elimination(exact, plan, start, rows, bounds, limit)
            velocities = jnp.where(system.free[:, None] > 0, velocities, system.prescribed)
            return Found(found, sides_of(bounds, found), info, velocities)

        return with_friction(system, operator, guess, once)


def _triples(model: Model, params: Params, state: State) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Triples that each group of rows acts on, and arrays as long as its blocks have rows."""
    rows = first_system(model, params, state).extra.values()
    return tuple(each.triples for each in rows), tuple(jnp.zeros(each.bias.shape[1], bool) for each in rows)
