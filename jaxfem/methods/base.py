"""What a method is: a way to solve a step, chosen with `build(solver=...)`.

A new method is a subclass of `Method` with a `name`, which becomes a frozen dataclass of its settings: that alone makes
it known to `build` and to scene files. It is part of the compiled program, so it holds flags and no arrays; what it
needs in arrays it makes in `plan` (from the topology, once, on the host), in `prepare` (for many steps of about the
same length) and in `start` (its memory from one step to the next).
"""

import abc
import dataclasses
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, dataclass_transform

import jax

from jaxfem.answers import COUNT, FLAG, REAL, flaw_of, still_says
from jaxfem.elements.mass import MassKind
from jaxfem.elements.strains import PLAIN
from jaxfem.materials.constants import Constant
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import Pytree
from jaxfem.registry import Registry
from jaxfem.schemes import Scheme
from jaxfem.solvers.status import SolveInfo

Array = jax.Array

AUTO = "auto"
"""Stands for the choice between methods."""
SOLVED = {"status": COUNT, "iterations": COUNT, "residual": REAL, "weakly_active": COUNT}
"""What each solve tells of itself."""


class Facts(NamedTuple):
    """What of a scene decides which methods can serve it.

    `soft`, `rigid`: whether it has such bodies; `tied`: whether it has joints or contacts; `mass`: kind of mass matrix;
    `strains`: kinds of strain rows of its bodies; `scheme`: the time scheme; `nonlinear`: the laws of its bodies that
    are not linear in the step.
    """

    soft: bool
    rigid: bool
    tied: bool
    mass: MassKind
    strains: tuple[str, ...]
    scheme: Scheme
    nonlinear: tuple[str, ...] = ()

    @property
    def smoothed(self) -> tuple[str, ...]:
        """The kinds of strain rows of its bodies that are not those of plain linear tetrahedra."""
        return tuple(each for each in self.strains if each != PLAIN)

    @property
    def coupled(self) -> bool:
        """Whether anything but soft bodies takes part."""
        return self.rigid or self.tied


class CannotServe(ValueError):
    """A method cannot make its plan for a scene; the message follows the method's name."""


class Solved(Pytree):
    """The solution of a step, by whichever method and at whichever stage: end-of-step `velocities` (n, 3) of all
    triples, `impulses` of the groups of rows that are solved for (None where there are none), and how the solve went.

    What is solved for below a step, by itself, is a pair: the solution, an array or a pytree, and its `SolveInfo`.
    """

    velocities: Array
    impulses: OrderedDict[str, Array] | None
    info: SolveInfo


class Elasticity(NamedTuple):
    """What a method has in place of the laws' elasticity: `energy` () [J] stored, `force` (n, 3) [N] on the nodes, that
    of its damping in it, and the `power` () [W] that damping takes."""

    energy: Array
    force: Array
    power: Array


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
class Method(abc.ABC):
    """A way to solve a step: see the head of this file. `name`: its word in `build` and in scene files.

    Each subclass is a frozen dataclass; one that says so itself with a decorator is as well.
    """

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]  # each subclass has its own
    name: ClassVar[str]
    nonlinear: ClassVar[bool] = False
    """Whether it serves materials that are not linear in the step."""
    as_it_is: ClassVar[bool] = False
    """Whether its step of soft bodies is that of `system.soft.step_system`, solved to the tolerance: another way to
    solve that gives the same, and sweeps may take theirs. Subclasses with a step or solve of their own say so anew."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "__init__" in cls.__dict__:
            raise TypeError(
                f"{cls.__name__} has an __init__ of its own: declare its numbers as fields of a frozen dataclass, by "
                "which compiled programs tell methods apart"
            )
        if "__eq__" in cls.__dict__:
            raise TypeError(f"{cls.__name__} compares in a way of its own: its fields tell compiled programs apart")
        dataclasses.dataclass(frozen=True)(cls)
        del cls.__setattr__, cls.__delattr__  # those below; a decorator of the class's own makes its own, but once
        if not still_says(cls, "as_it_is", "step", "solve", "round"):
            cls.as_it_is = False
        if loose := [each.name for each in dataclasses.fields(cls) if not each.compare]:
            raise TypeError(
                f"{cls.__name__}.{loose[0]} is left out of comparison (compare=False): compiled programs tell methods "
                "apart by their fields"
            )
        name = cls.__dict__.get("name")
        if name is None or hasattr(name, "__get__"):  # abstract, or a wrapper that has its inner method's
            return
        if cls.name == AUTO:
            raise TypeError(f'{cls.__name__} calls itself "{AUTO}", which stands for the choice between methods')
        if flaw := flaw_of(cls, {"nonlinear": FLAG, "as_it_is": FLAG}):
            raise TypeError(f"{cls.__name__} has {flaw}")
        METHODS.add(cls.name, cls)

    def __setattr__(self, name: str, value: Any) -> None:
        raise dataclasses.FrozenInstanceError(f"a method does not change: make another {type(self).__name__}")

    def __delattr__(self, name: str) -> None:
        raise dataclasses.FrozenInstanceError(f"a method does not change: make another {type(self).__name__}")

    def refuses(self, facts: Facts) -> str | None:
        """Why it cannot serve a scene, in words that follow its name, or None."""
        return None

    def constants(self) -> Mapping[Constant, float]:
        """Constants of its own with their values; they go to `Params`, to be fitted and differentiated like others.

        Their names are the method's alone: what `params` hold anyway is read there. `build` refuses others.
        """
        return {}

    def plan(self, model: Model, params: Params, state: State) -> Any:
        """What it makes of the topology, once, on the host; kept as `model.plan`. CannotServe says why it cannot."""
        return None

    def prepare(self, model: Model, params: Params, state: State, dt: Array) -> Any:
        """What pays to be made once for many steps of about `dt` [s]; kept as `model.cache`, or by a rollout.

        It changes no solution, only how fast it is found: no derivative passes through it.
        """
        return None

    def start(self, model: Model, params: Params, state: State) -> Any:
        """The first `State.memory`."""
        return None

    def elasticity(self, model: Model, params: Params, positions: Array, rates: Array) -> Elasticity | None:
        """What its bodies store and lose at `positions` and their `rates` (n, 3) [m, m/s], where that is not what the
        laws on their elements do, but the method's own: energies then tell it, statics and modes refuse."""
        return None

    @property
    def own_elasticity(self) -> bool:
        """Whether it has such."""
        return type(self).elasticity is not Method.elasticity

    @abc.abstractmethod
    def step(
        self, model: Model, params: Params, state: State, dt: Array, forces: Array | None, cache: Any
    ) -> tuple[State, StepInfo]:
        """One step of `dt` [s]; `forces` (n, 3) [N] or None; `cache`: what `prepare` made."""

    def impulses(self, model: Model, memory: Any) -> OrderedDict[str, Array]:
        """Impulses of the last step by the names of their groups of rows, as far as the `memory` holds them."""
        return OrderedDict()


def refused_elasticity(model: Model) -> str | None:
    """Why what tells of the laws' elasticity cannot serve a scene, or None."""
    if not model.method.own_elasticity:
        return None
    return (
        f'takes the materials\' laws on their elements, and the method "{model.method.name}" has forces of its own in '
        'their place: build with solver="condensed" for that, or take steps with damping until it rests'
    )


def solves_as_it_is(method: Any) -> bool:
    """Whether a method says that of itself."""
    return bool(getattr(method, "as_it_is", False))


METHODS: Registry["Method"] = Registry("method")
"""All methods by name."""
