"""What a sweep keeps of each variant: a function of the rollout, or one of these by its word."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import FLAG, described, flaw_of
from jaxfem.declared.errors import SceneError
from jaxfem.energies import energies
from jaxfem.inputs import Count, Vector, takes
from jaxfem.mesh import MeshError, locate
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import Pytree
from jaxfem.registry import Registry
from jaxfem.stepping import StepError, impulses
from jaxfem.sweeping.errors import SweepError
from jaxfem.tensors import contract
from jaxfem.vibration import modes

Array = jax.Array
OUTSIDE = 1e-6  # of the bodies' size


class Observed(Pytree):
    """One variant's run: its `params`, the `start`, saved `states` and `infos` (leading axis k), the time step `dt`."""

    model: Model
    params: Params
    start: State
    states: State
    infos: StepInfo
    dt: Array

    @property
    def last(self) -> State:
        """The last saved state."""
        found: State = jax.tree.map(lambda leaf: leaf[-1], self.states)
        return found


class Output:
    """A named output: a frozen dataclass whose `measured(model)` returns the function of an `Observed` run; one
    without a word is for Python alone.

    The function gives an array, or several by name; it is compiled with the run.
    """

    word: ClassVar[str] = ""
    frames: ClassVar[bool] = True
    """Whether the first axis is that of the saved frames."""

    def __init_subclass__(cls, word: str = "", **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if not word:
            return  # for Python alone
        if flaw := flaw_of(cls, {"frames": FLAG}):
            raise TypeError(f"{cls.__name__} has {flaw}")
        cls.word = word
        OUTPUTS.add(word, cls)

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """What takes the numbers of a run; SweepError where the scene has none such."""
        raise NotImplementedError


OUTPUTS: Registry[Output] = Registry("output")
"""All named outputs by their words."""


@dataclasses.dataclass(frozen=True)
class PointPath(Output, word="point"):
    """Displacement (k, 3) [m] of the material `point` (3,) [m] of the undeformed bodies, at each saved frame."""

    point: Any = dataclasses.field(metadata=takes(Vector("m")))

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """By the corners of the element around it."""
        if not model.bodies:
            raise SweepError(f"the point {tuple(self.point)} needs a soft body: the scene has none")
        rest, cells = np.asarray(model.rest, np.float64), np.asarray(model.elements.cells, np.int64)
        place = _place(self.point)
        elements, weights, off = locate(rest, cells, place[None])
        if off[0] > OUTSIDE * np.ptp(rest, axis=0).max():
            raise SweepError(f"the point {tuple(place.tolist())} lies {off[0]:.3g} m outside the bodies")
        corners, share = jnp.asarray(cells[elements[0]], jnp.int32), jnp.asarray(weights[0], model.rest.dtype)

        def path(run: Observed) -> Array:
            found: Array = contract("a,kai->ki", share, run.states.positions[:, corners] - model.rest[corners])
            return found

        return path


def _place(point: Any) -> np.ndarray:
    try:
        place = np.asarray(point, float)
    except (TypeError, ValueError):
        place = np.empty(0)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise SweepError(f"the point is {point!r}; give x, y and z in metres")
    return place


@dataclasses.dataclass(frozen=True)
class EnergyPaths(Output, word="energies"):
    """Energies [J] by kind, (k,) each."""

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """Of each saved state."""
        return lambda run: jax.lax.map(lambda at: energies(run.model, run.params, at).kinds, run.states)


@dataclasses.dataclass(frozen=True)
class ContactForces(Output, word="contact_forces"):
    """Sum of the normal forces of each group of contacts (k,) [N], as an average over the step before each frame."""

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """From the impulses of the last step."""
        if not model.contacts:
            raise SweepError("contact_forces: the scene has no contacts")

        def forces(run: Observed) -> dict[str, Array]:
            found = impulses(run.model, run.states)
            return {
                name: found[f"contact {name}"].sum((-2, -1)) / run.dt
                for name in run.model.contacts
                if f"contact {name}" in found
            }

        return forces


@dataclasses.dataclass(frozen=True)
class Frequencies(Output, word="frequencies"):
    """The `count` lowest natural frequencies (count,) [Hz] about the shape at the start."""

    count: Any = dataclasses.field(default=3, metadata=takes(Count()))
    frames: ClassVar[bool] = False

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """As `jf.modes` finds them, which refuses what has none."""
        if flaw := Count().flaw(self.count):
            raise SweepError(f"count is {self.count!r}: {flaw}")
        count = int(self.count)
        return lambda run: modes(run.model, run.params, run.start, count)[0] / (2 * jnp.pi)


@dataclasses.dataclass(frozen=True)
class Positions(Output, word="positions"):
    """Positions of all nodes (k, n, 3) [m]: the trajectory."""

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """The saved ones."""
        return lambda run: run.states.positions


@dataclasses.dataclass(frozen=True)
class RigidPoses(Output, word="rigid"):
    """Places (k, b, 3) [m] and orientations (k, b, 4) of the rigid bodies."""

    def measured(self, model: Model) -> Callable[[Observed], Any]:
        """The saved ones."""
        if model.rigid is None:
            raise SweepError("rigid: the scene has no rigid bodies")

        def poses(run: Observed) -> dict[str, Array]:
            rigid: Any = run.states.rigid
            return {"positions": rigid.positions, "orientations": rigid.orientations}

        return poses


def measuring(model: Model, outputs: Mapping[str, Any]) -> Callable[[Observed], dict[str, Array]]:
    """One function for all outputs: name -> array, those of an output that has several behind its name and a dot.

    Each is a function of an `Observed`, an `Output`, or the word of one that needs no more.
    """
    if not isinstance(outputs, Mapping) or not outputs:
        raise SweepError(
            f"outputs are {outputs!r}; a sweep needs outputs: name -> a function of the run, or one of "
            f"{', '.join(OUTPUTS.words())}"
        )
    made = {name: _function(model, name, each) for name, each in outputs.items()}

    def all_of(run: Observed) -> dict[str, Array]:
        found = dict[str, Array]()
        for name, function in made.items():
            value = _asked(name, function, run)
            own = (
                {f"{name}.{kind}": each for kind, each in value.items()}
                if isinstance(value, Mapping)
                else {name: value}
            )
            if not own:
                raise SweepError(f'output "{name}" gave nothing; give an array of numbers, or several by name')
            for key, each in own.items():
                if key in found:
                    raise SweepError(f'two outputs are called "{key}": give one of them another name')
                found[key] = _numbers(key, each)
        return found

    return all_of


def _asked(name: str, function: Callable[[Observed], Any], run: Observed) -> Any:
    """What a function answers; what one of the user's own raises is his, with a note that says where."""
    try:
        return function(run)
    except StepError as problem:
        raise SweepError(f'output "{name}": {problem}') from None
    except Exception as problem:
        problem.add_note(
            f'in output "{name}" of a sweep: it takes one Observed run, and is compiled (jax.numpy in place of numpy, '
            "jnp.where in place of if)"
        )
        raise


def _numbers(name: str, value: Any) -> Array:
    try:
        return jnp.asarray(value)
    except (TypeError, ValueError):
        kind = type(value).__name__
        raise SweepError(f'output "{name}" gave {kind}; give an array of numbers, or several by name') from None


def _function(model: Model, name: str, given: Any) -> Callable[[Observed], Any]:
    if not isinstance(name, str) or not name:
        raise SweepError(f"{name!r} is no name of an output: give a word, like tip")
    if isinstance(given, str):
        if given not in OUTPUTS:
            raise SweepError(f'output "{name}" is {given!r}; known are {", ".join(OUTPUTS.words())}')
        try:
            given = OUTPUTS[given].made()
        except TypeError as problem:
            raise SweepError(f'output "{name}" needs more than its word: {problem}') from None
    if isinstance(given, type):
        raise SweepError(f'output "{name}" is the class {given.__name__}: give one of it, {given.__name__}(...)')
    if hasattr(given, "measured"):
        try:
            found: Any = given.measured(model)
        except (SweepError, SceneError, MeshError) as problem:
            raise SweepError(f'output "{name}": {problem}') from None
        if not callable(found):
            said = f"`measured` of {type(given).__name__} gives {described(found)}"
            raise SweepError(f'output "{name}": {said}; it must give a function of the run')
        measured: Callable[[Observed], Any] = found
        return measured
    if not callable(given):
        raise SweepError(f'output "{name}" is {given!r}; give a function of the run, or one of the named outputs')
    function: Callable[[Observed], Any] = given
    return function
