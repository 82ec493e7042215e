"""What the methods that solve for a step's rows share: the step's system, its end, and their memory of impulses."""

import abc
from collections import OrderedDict
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.methods.base import Method, Solved
from jaxfem.methods.ending import ended
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.rows.base import Rows
from jaxfem.system.coupled import coupled_system, velocities_of
from jaxfem.system.momentum import kept
from jaxfem.system.soft import System, step_system

Array = jax.Array
Impulses = OrderedDict[str, Array]


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
        system = system_of(model, params, state, dt, forces)
        solved = self.solve(system, model.plan, cache, velocities_of(state), state.memory)
        solved = solved.replace(velocities=kept(model, system, solved.velocities, solved.impulses))
        return ended(model, params, state, dt, solved, system.impact, system.passed, forces)

    def start(self, model: Model, params: Params, state: State) -> Impulses | None:
        """Zero impulses, in the rows' shapes."""
        step = jnp.ones((), model.rest.dtype)
        bare = state.replace(memory=None)
        shapes = jax.eval_shape(
            lambda: OrderedDict(
                (name, rows.bias) for name, rows in self.solved_rows(system_of(model, params, bare, step, None)).items()
            )
        )
        return OrderedDict((name, jnp.zeros(each.shape, each.dtype)) for name, each in shapes.items())

    def impulses(self, model: Model, memory: Any) -> Impulses:
        """The memory itself."""
        return OrderedDict() if memory is None else memory


def system_of(model: Model, params: Params, state: State, dt: Array, forces: Array | None) -> System:
    """The step's system, of soft bodies alone or of all that the scene holds."""
    if model.coupled:
        return coupled_system(model, params, state, dt, forces, state.memory)
    return step_system(model, params, state, dt, forces)
