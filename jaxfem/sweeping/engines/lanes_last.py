"""Soft bodies with lanes last: see `jaxfem.sweeping.lanes`."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import numpy as np

from jaxfem.elements.domains import Domains
from jaxfem.elements.mass import is_diagonal
from jaxfem.elements.tetra import has_energy
from jaxfem.methods.base import solves_as_it_is
from jaxfem.model import Model, Params, State
from jaxfem.sweeping.engines.base import Engine, Kept, Task
from jaxfem.sweeping.lanes.body import Body, body_of
from jaxfem.sweeping.lanes.costs import costs
from jaxfem.sweeping.lanes.derivatives import run_with_derivatives
from jaxfem.sweeping.lanes.modes import ALL
from jaxfem.sweeping.lanes.run import begin, frames, keep
from jaxfem.sweeping.places import stacked
from jaxfem.system.names import contact_name, friction_name, joint_name

Array = jax.Array
LARGEST = 30_000  # free directions, beyond which nothing was measured


class LanesLast(Engine):
    """Chunks of lanes that go through each step together."""

    name: ClassVar[str] = "lanes"
    width: ClassVar[int] = 32
    elements: ClassVar[float] = 4e6  # some 5 GB in double precision

    def states_at_once(self, width: int) -> int:
        """All of a chunk."""
        return width

    def refuses(self, task: Task) -> str | None:
        """What is not written with lanes last."""
        model, state = task.model, task.state
        shared = not is_diagonal(model.mass)
        linear = not model.nonlinear and not model.has_memory
        rigid = model.rigid is not None
        known = isinstance(state.memory, Mapping) and {*state.memory} == _groups(model)
        others = model.coupled and not known
        reasons = {
            "takes soft bodies, with joints and contacts or without, and this scene has rigid ones": rigid,
            f'takes joints and contacts by a method that keeps their impulses alone, not "{model.method.name}"': others,
            "takes laws that are linear and without a memory, and this scene has another": not linear,
            "takes strain of elements, and this scene smooths it": not all(map(_by_element, model.domains)),
            "takes bodies that something holds, where masses are not lumped": shared and model.drifting is not None,
            "takes the nearest rotation": not has_energy(model.rotation_kind),
            f'takes methods that solve the step as it is, not "{model.method.name}"': not solves_as_it_is(model.method),
            f'takes schemes that know of lanes, not "{model.scheme.name}"': not model.scheme.lanes,
            "keeps no account of energy": state.account is not None,
            "takes no failed step again": task.halvings > 0,
            "takes scenes of build, not of rebuild": model.reshaped,
            f"takes at most {LARGEST} free directions": 3 * int(model.free.sum()) > LARGEST,
        }
        return next((words for words, so in reasons.items() if so), None)

    def slower(self, task: Task) -> str | None:
        """With joints and contacts, whose active sets each lane waits for all others to find, and for large bodies."""
        if task.model.coupled:
            return "is no faster with joints and contacts"
        return f"is no faster above {ALL} free directions" if 3 * int(task.model.free.sum()) > ALL else None

    def prepare(self, task: Task) -> Body:
        """Connectivity and modes."""
        return body_of(task.model, task.params)

    def costs(self, task: Task, prepared: Body, variants: Mapping[str, np.ndarray]) -> np.ndarray:
        """By what the modes do not know of each."""
        values = {name: stacked(each, task.model.rest.dtype) for name, each in variants.items()}
        found = jax.jit(lambda *given: costs(task, *given))((task.model, task.params, task.state), prepared, values)
        return np.asarray(found)

    def make(self, task: Task) -> Callable[[Any, Any, Any], Kept]:
        """Of the whole chunk."""

        def run(parts: tuple[Model, Params, State], body: Body, values: dict[str, Array]) -> Kept:
            if task.derivatives:
                return run_with_derivatives(task, parts, body, values)
            begun = begin(task, parts[0], parts, body, values)
            return keep(task, parts[0], body, begun, *frames(task, parts[0], body, begun))

        return run


def _by_element(domains: Domains) -> bool:
    """Whether they are elements, all or some."""
    return domains.whole and domains.clusters is None and (domains.members is None or domains.members.shape[1] == 1)


def _groups(model: Model) -> set[str]:
    """Names of the groups of rows that are not elastic."""
    rough = {friction_name(label) for label, group in model.contacts.items() if group.rough}
    return {*map(joint_name, model.joints), *map(contact_name, model.contacts), *rough}
