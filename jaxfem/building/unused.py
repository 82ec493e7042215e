"""What a scene declares and nothing uses: a warning from `build` that names it."""

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.answers import described, odd_pair
from jaxfem.batching import one_program
from jaxfem.building.bodies import BodyIndex
from jaxfem.declared import RigidBody, SceneError
from jaxfem.declared.errors import told
from jaxfem.declared.scene import Scene, SoftBody
from jaxfem.loads import ResolvedLoad
from jaxfem.model import Model, Params


class UnusedWarning(UserWarning):
    """Something is declared that changes nothing."""


def warn_of_unused(scene: Scene, names: Sequence[str], model: Model, params: Params) -> None:
    """Warn of each number of a scene that changes nothing; host side. `names`: unique ones of all bodies, in order."""
    rigid = [name for name, body in zip(names, scene.bodies, strict=True) if isinstance(body, RigidBody)]
    found = [*_of_rigid(scene.rigid, rigid), *_of_soft(scene.soft, model), *_of_pairs(scene, rigid, model)]
    found += [*_of_joints(model, params)]
    for each in (*scene.joints, *scene.contacts):
        found += [f'"{each.label}" has {words}' for words in told(each, "unused", f'"{each.label}"')]
    for said in dict.fromkeys(found):
        warnings.warn(f"{said}: that changes nothing", UnusedWarning, stacklevel=3)


def _of_rigid(bodies: Sequence[RigidBody], names: Sequence[str]) -> Iterator[str]:
    """Velocities of what does not move by them."""
    for body, name in zip(bodies, names, strict=True):
        if not (body.fixed or body.motion is not None):
            continue
        for what in ("velocity", "angular_velocity"):
            given = np.asarray(getattr(body, what), float)
            if given.any() and not (body.motion and np.allclose(given, getattr(body.motion, what))):
                yield f'{what} of "{name}", which {"is fixed" if body.fixed else "follows its motion"}'


def _of_soft(bodies: Sequence[SoftBody], model: Model) -> Iterator[str]:
    """Loads that act on held nodes alone, and velocities of bodies that are held altogether."""
    free, owner = np.asarray(model.free) > 0, np.asarray(model.node_body)
    loads = iter(_reached(model.loads, [jnp.asarray(each.value) for body in bodies for each in body.loads], model.rest))
    for number, (body, name) in enumerate(zip(bodies, model.bodies, strict=True)):
        for each in body.loads:
            reached = np.asarray(next(loads))
            if reached.any() and not (reached & free).any():
                yield f'a {type(each).__name__} on "{name}", on nodes that are all fixed or driven'
        if np.any(np.asarray(body.velocity, float)) and not free[owner == number].any():
            yield f'velocity of "{name}", whose nodes are all fixed or driven'


@one_program
def _reached(loads: Sequence[ResolvedLoad], values: Sequence[Any], rest: jax.Array) -> list[jax.Array]:
    """Whether each load would act on each node, (n,)."""
    ones = [jnp.ones(jnp.shape(value), rest.dtype) for value in values]
    return [jnp.any(load.force(one, rest) != 0, axis=1) for load, one in zip(loads, ones, strict=True)]


def _of_pairs(scene: Scene, rigid: Sequence[str], model: Model) -> Iterator[str]:
    """Joints and contacts between what does not move by itself."""
    if not (scene.joints or scene.contacts):
        return
    index = BodyIndex(scene.soft, model.bodies, scene.rigid, rigid)
    held = ~np.isin(np.arange(len(scene.soft)), np.asarray(model.node_body)[np.asarray(model.free) > 0])

    def moves(partner: Any) -> bool:
        if not isinstance(partner, str | SoftBody | RigidBody):
            return False
        kind, number = index.find(partner, "a joint or contact")
        if kind == "soft":
            return not held[number]
        return not (scene.rigid[number].fixed or scene.rigid[number].motion is not None)

    for each in (*scene.joints, *scene.contacts):
        if not (moves(each.a) or moves(each.b)):
            yield f'"{each.label}", whose ends are all fixed or follow a motion'


def _of_joints(model: Model, params: Params) -> Iterator[str]:
    """Numbers of joints that the others make of no use."""
    for label, group in model.joints.items():
        on_host = jax.tree.map(np.asarray, params.joints[label])
        idle = group.idle(on_host)
        if (odd := odd_pair(idle, str)) is not None:
            raise SceneError(
                f'`idle`{odd[0]} of the rows "{label}" gives {described(odd[1])}; it must give a mapping of fields to '
                "which of the joints (m,) have such, and why, in words"
            )
        for field, (where, why) in idle.items():
            names = [name for name, one in zip(group.names, np.asarray(where), strict=True) if one]
            for name in names:
                yield f'{field} of joint "{name}" (rows "{label}"), {why}'
