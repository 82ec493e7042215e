"""What the methods that solve for a step's rows share: the step's system, its end, and their memory of impulses."""

import abc
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described, flaw_of, is_exact
from jaxfem.batching import cond_any, one_trace
from jaxfem.methods.base import SOLVED, Method, Solved
from jaxfem.methods.ending import ended
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import Pytree, on_device
from jaxfem.rigid.slender import slender_status
from jaxfem.rows.base import Rows
from jaxfem.rows.bounds import beyond_cone
from jaxfem.solvers.differentiation import recomputed
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.coupled import configuration, coupled_system, midway_inertia, velocities_of
from jaxfem.system.giving import gave_way
from jaxfem.system.holding import held, unmet
from jaxfem.system.momentum import kept, turning_status, turns_ahead
from jaxfem.system.piercing import piercing_status
from jaxfem.system.pull import pull_grew, pulls
from jaxfem.system.soft import System, step_system
from jaxfem.system.unsolved import unsolved

Array = jax.Array
Impulses = OrderedDict[str, Array]

PULL_ROUNDS = 2
"""Solves of a step at most, while the pull of its joints grows."""


class Ended(Pytree):
    """A step's solution, and what of its system the end of the step needs; `missed`: see `unmet`, `gave`: `gave_way`.

    `spin`: along which free rigid bodies turn. It is kept, not found anew: rounding may lead to another solution.
    `pulled`: how hard joints pulled on them, by the impulses that it was solved with. `beyond`: see `beyond_cone`.
    """

    solved: Solved
    missed: dict[str, Array]
    gave: Array | None
    impact: Array | None
    passed: Array | None
    spin: Array | None
    pulled: Array | None
    beyond: Array | None


class RowMethod(Method):
    """A method that solves the step's `System`; its memory: the last impulses of the groups that it solves for."""

    @abc.abstractmethod
    def solve(self, system: System, plan: Any, cache: Any, velocities: Array, impulses: Impulses | None) -> Solved:
        """Solve a step, from the last step's `velocities` (n, 3) of all triples and `impulses`; differentiable."""

    def solved_rows(self, system: System) -> OrderedDict[str, Rows]:
        """The groups of rows whose impulses it solves for."""
        return system.rows

    def step(
        self, model: Model, params: Params, state: State, dt: Array, forces: Array | None, cache: Any
    ) -> tuple[State, StepInfo]:
        """Make the system, solve it, and move everything with the velocities found."""

        def once(impulses: Impulses | None, spent: Array) -> Ended:
            system = system_of(model, params, state, dt, forces, impulses)
            system = system.replace(max_iterations=system.max_iterations - spent)
            solved = self.solve(system, model.plan, cache, velocities_of(state), impulses)
            self._check(system, solved)
            solved = solved.replace(velocities=kept(model, system, state.positions, solved.velocities, solved.impulses))
            missed = unmet(model, system, solved.velocities, solved.impulses or {})
            gave = gave_way(model, system, solved.impulses or {}, dt)
            beyond = beyond_cone(system.friction, jax.lax.stop_gradient(solved.impulses or {}))
            return Ended(solved, missed, gave, system.impact, system.passed, system.spin, system.pulled, beyond)

        none = jnp.int32(0)
        found = with_fresh_pull(model, params, state, dt, once) if pulls(model) else once(state.memory, none)
        following, info = ended(model, params, state, dt, found.solved, found.impact, found.passed, forces, found.spin)
        status = info.status
        if model.joints:
            status = held(model, params, configuration(following), velocities_of(following), found.missed, dt, status)
        if found.gave is not None:
            status = jnp.where(status == int(Status.CONVERGED), found.gave, status)
        status = piercing_status(model, state, status)
        status = turning_status(model, params, state, dt, status)
        if model.rigid is not None:
            status = slender_status(model.rigid, following.rigid, dt, status)
        return following, info.replace(status=status, beyond_cone=found.beyond)

    def _check(self, system: System, solved: Any) -> None:
        """TypeError for what is no solution; seen while the step is traced, and no part of it."""
        if flaw := _flaw(self.solved_rows(system), system.target, solved):
            raise TypeError(f'`solve` of the method "{self.name}" gives {flaw}')

    def start(self, model: Model, params: Params, state: State) -> Impulses | None:
        """Zero impulses, in the rows' shapes."""
        rows = self.solved_rows(jax.eval_shape(first_system, model, params, state))
        shapes = ((name, each.bias) for name, each in rows.items())
        return OrderedDict((name, on_device(np.zeros(bias.shape), bias.dtype)) for name, bias in shapes)

    def impulses(self, model: Model, memory: Any) -> Impulses:
        """The memory itself."""
        return OrderedDict() if memory is None else memory


def _flaw(rows: OrderedDict[str, Rows], target: Array, solved: Any) -> str:
    """What is wrong with a solution; empty where nothing is."""
    if flaw := solved_flaw(solved, target):
        return flaw
    dtype = target.dtype
    impulses: Any = {} if solved.impulses is None else solved.impulses
    known = isinstance(impulses, Mapping) and {*impulses} == {*rows}
    if not known or not all(is_exact(impulses[name], [each.bias.shape], dtype) for name, each in rows.items()):
        wanted = ", ".join(f'"{name}" {each.bias.shape}' for name, each in rows.items()) or "none"
        return (
            f"impulses that are {jax.tree.map(described, impulses)}; it must give those of the rows: {wanted}; "
            "where it solves for fewer of them, or for none, `solved_rows` says so"
        )
    return ""


def solved_flaw(solved: Any, like: Array) -> str:
    """What is wrong with a solution but for its impulses; empty where nothing is. Velocities are as `like` (n, 3)."""
    shape = jnp.shape(like)
    if not isinstance(solved, Solved) or not is_exact(solved.velocities, [shape], like.dtype):
        given = described(solved.velocities) if isinstance(solved, Solved) else described(solved)
        return f"{given}; it must give a Solved, with velocities {shape} of all triples, impulses and info"
    if not isinstance(solved.info, SolveInfo):
        return f"info = {described(solved.info)}; it must give a SolveInfo"
    flaw = flaw_of(solved.info, SOLVED)
    return flaw and f"an info whose {flaw}"


def with_fresh_pull(
    model: Model, params: Params, state: State, dt: Array, once: Callable[[Impulses | None, Array], Ended]
) -> Ended:
    """`once(impulses, spent)`, a step's solution with the geometric stiffness of those impulses, and again where it
    must be; `spent`: the iterations that earlier ones took of the step's limit.

    A loop, in which what is not needed is passed over, so that the step is compiled once.
    """
    middle, once = midway_inertia(model, params, state, dt), one_trace(once)

    def trip(carry: tuple[Impulses, Ended, Array], _: None) -> tuple[tuple[Impulses, Ended, Array], None]:
        pull, last, due = carry

        def again(pull: Impulses, last: Ended) -> tuple[Ended, Array]:
            found = once(pull, last.solved.info.iterations)
            info = found.solved.info
            info = info.replace(iterations=info.iterations + last.solved.info.iterations)
            fresh = found.solved.impulses
            assert fresh is not None and found.pulled is not None
            grew = pull_grew(model, middle, found.pulled, fresh, dt, configuration(state))
            return found.replace(solved=found.solved.replace(info=info)), grew

        found, due = cond_any(due, recomputed(again), lambda _, last: (last, jnp.bool_(False)), pull, last)
        assert found.solved.impulses is not None
        return (found.solved.impulses, found, due), None

    assert state.memory is not None
    blank = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(once, state.memory, jnp.int32(0))
    )
    start = (state.memory, blank, jnp.bool_(True))
    solution: Ended = jax.lax.scan(trip, start, None, length=PULL_ROUNDS)[0][1]
    return solution


@unsolved
def first_system(model: Model, params: Params, state: State) -> System:
    """The system of a step of 1 s from a state without a memory; what `build` asks of it is traced once for a scene."""
    return system_of(model, params, state, jnp.ones((), model.rest.dtype), None)


def system_of(
    model: Model, params: Params, state: State, dt: Array, forces: Array | None, pull: Impulses | None = None
) -> System:
    """The step's system, of soft bodies alone or of all that the scene holds; `pull`: see `coupled_system`."""
    if model.coupled:
        return coupled_system(model, params, state, dt, forces, pull)
    return step_system(model, params, state, dt, forces, turns=turns_ahead(model, params, state, dt))
