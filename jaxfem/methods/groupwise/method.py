"""The method: how groups are made and tied, exactly or by the iteration of (11) and (12)."""

import warnings
from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.declared.errors import AccuracyWarning
from jaxfem.materials.constants import Constant
from jaxfem.methods.base import Elasticity, Facts, Method, Solved
from jaxfem.methods.ending import ended
from jaxfem.methods.groupwise.binding import bound_solution
from jaxfem.methods.groupwise.matrices import eliminated, group_inverses
from jaxfem.methods.groupwise.plan import Groups, element_groups, group_plan
from jaxfem.methods.groupwise.solve import ExactCondition, Prepared
from jaxfem.methods.groupwise.system import group_elasticity, group_system
from jaxfem.methods.node_blocks import check_linear, check_polar, refuses_but_plain
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import Pytree
from jaxfem.solvers.implicit import implicit_solution
from jaxfem.solvers.status import SolveInfo, Status, caused

Array = jax.Array

BINDING = Constant(
    "binding",
    "N/m",
    "must be >= 0 N/m; its stability limit is `binding_limit`",
    label="binding coefficient",
    low=0.0,
    closed=True,
)
SAFE = 0.95
"""Of the limit of the binding coefficient: what is enforced."""
TORN = 0.1
"""Of the scene's size: copies of a node this far apart after the rounds of a step are no node any more."""
APART = "the groups came apart: take more rounds, a larger binding coefficient or smaller steps, or binding = exact"
UNSTABLE = "the binding coefficient of groupwise is above its stability limit: lower it, or leave enforce on"


class GroupMemory(Pytree):
    """`gap` () [m]: the largest distance between copies of a node and their mean in the last step."""

    gap: Array


class Groupwise(Method):
    """Bodies cut into `groups` each, or into groups of at most `size` elements, with one rotation a group.

    `binding`: "exact", one velocity a node; or k [N/m] of (12), then `rounds` of it a step, `params.binding`
    from then on: what is above the stability limit is lowered to it where `enforce`, else has a status; `info.residual`
    is then how far copies of a node are apart, as a share of their velocities.
    """

    groups: int | None = 4
    size: int | None = None
    binding: Any = "exact"
    rounds: int = 30
    enforce: bool = True
    name: ClassVar[str] = "groupwise"

    def refuses(self, facts: Facts) -> str | None:
        """All but plain bodies, and settings that make no sense."""
        for what, value in (("groups", self.groups), ("size", self.size), ("rounds", self.rounds)):
            if value is None and (what == "size" or (what == "groups" and self.size is not None)):
                continue
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 1:
                return f"has {what} = {value!r}: give a whole number of at least 1"
        number = isinstance(self.binding, int | float | np.number) and not isinstance(self.binding, bool)
        if self.binding != "exact" and not (number and 0 <= self.binding < float("inf")):
            return f'has binding = {self.binding!r}: give "exact", or a coefficient k of at least 0 N/m'
        if not isinstance(self.enforce, bool | np.bool_):
            return f"has enforce = {self.enforce!r}: give True or False"
        return refuses_but_plain(facts)

    def constants(self) -> Mapping[Constant, float]:
        """The binding coefficient, where it is one."""
        return {} if self.binding == "exact" else {BINDING: float(self.binding)}

    def plan(self, model: Model, params: Params, state: State) -> Groups:
        """The groups."""
        check_linear(model)
        check_polar(model)
        if self.binding == 0:
            warnings.warn("binding = 0 N/m ties no groups: each moves by itself", AccuracyWarning, stacklevel=6)
        return group_plan(model, element_groups(model, self.groups, self.size))

    def prepare(self, model: Model, params: Params, state: State, dt: Array) -> Any:
        """The groups' matrices for `dt`, inverted: whole, with the limit of the binding coefficient, or in parts."""
        system = group_system(model, params, state, dt, None)
        return eliminated(system, model) if self.binding == "exact" else group_inverses(system, model, dt)

    def start(self, model: Model, params: Params, state: State) -> GroupMemory:
        """No gap."""
        return GroupMemory(jnp.zeros((), model.rest.dtype))

    def elasticity(self, model: Model, params: Params, positions: Array, rates: Array) -> Elasticity:
        """That of the groups, each about its own rotation."""
        return Elasticity(*group_elasticity(model, params, positions, rates))

    def step(
        self, model: Model, params: Params, state: State, dt: Array, forces: Array | None, cache: Any
    ) -> tuple[State, StepInfo]:
        """One step, the groups tied in whichever way."""
        given = Prepared(group_system(model, params, state, dt, forces), cache)
        if self.binding == "exact":
            unknown, info = implicit_solution(ExactCondition(), given, state.velocities)
            velocities, gap = given.system.merged(unknown), jnp.zeros((), model.rest.dtype)
        else:
            (velocities, gap), info = self._bound(given, params.constants[BINDING.name], dt, model.rest)
        following, told = ended(model, params, state, dt, Solved(velocities, None, info), forces=forces)
        return following.replace(memory=GroupMemory(jax.lax.stop_gradient(dt * gap))), told

    def _bound(
        self, given: Prepared, coefficient: Array, dt: Array, rest: Array
    ) -> tuple[tuple[Array, Array], SolveInfo]:
        """Velocities (n, 3) and gap [m/s], and info, after the rounds; what is above the limit is lowered or told. Also
        told: where copies of a node end far apart, by the size of the scene at `rest` (n, 3)."""
        limit = given.matrices.limit_at(dt)
        used = jnp.minimum(coefficient, SAFE * limit) if self.enforce else coefficient
        found, info = bound_solution(given, used, self.rounds, dt)
        torn = dt * found[1] > TORN * jnp.max(jnp.ptp(rest, axis=0))
        status = jnp.where(torn, caused(Status.ITERATION_LIMIT, APART), info.status)
        if not self.enforce:
            status = jnp.where(coefficient > limit, caused(Status.INVALID_VALUE, UNSTABLE), status)
        return found, info.replace(status=status.astype(jnp.int32))


def binding_limit(model: Model, params: Params, state: State, dt: Any) -> Array:
    """The coefficient k [N/m] from which the binding iteration may diverge, for steps of `dt` [s]; () Array.

    Below it it converges: the limit is 2 over p dt^2 times the largest eigenvalue of the groups' S A^-1 S', p the
    copies of a node at most, which no rotation of the groups changes.
    """
    found: Array = _limit(model, params, state, jnp.asarray(dt, model.rest.dtype))
    return found


@jax.jit
def _limit(model: Model, params: Params, state: State, dt: Array) -> Array:
    return group_inverses(group_system(model, params, state, dt, None), model, dt).limit


def interface_gap(state: State) -> Array:
    """The largest distance [m] between a copy of a shared node and the mean of its copies in the last step."""
    gap: Array = state.memory.gap
    return gap
