"""Which bodies nothing holds, and which of them joints or contacts may tie, for `system/momentum.py`."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxfem.declared import RigidBody
from jaxfem.declared.scene import Scene, SoftBody
from jaxfem.model import Drifting, Model
from jaxfem.pytrees import on_device


def drifting_bodies(scene: Scene, names: Sequence[str], model: Model) -> Drifting | None:
    """None where no soft body is loose. `names`: unique names of all bodies, in the scene's order."""
    count = len(model.bodies)
    node_body = np.asarray(model.node_body)
    held = np.zeros(count, bool)
    np.logical_or.at(held, node_body, np.asarray(model.free) == 0)
    if held.all():
        return None
    rigid = np.zeros(0) if model.rigid is None else np.asarray(model.rigid.free)
    loose = np.concatenate([~held, rigid > 0])
    together = _together(scene, names, loose)
    soft = np.arange(len(loose)) < count
    body = np.concatenate([node_body, np.arange(count, len(loose))])
    both = [np.array([flags[together == number].all() for number in range(len(loose))]) for flags in (loose, soft)]
    dtype = model.rest.dtype
    return Drifting(
        body=on_device(body, jnp.int32),
        together=on_device(together, jnp.int32),
        loose=on_device(np.concatenate([loose, both[0]]), dtype),
        soft=on_device(np.concatenate([soft, both[1]]), dtype),
    )


def _together(scene: Scene, names: Sequence[str], loose: np.ndarray) -> np.ndarray:
    """The least number among the bodies that joints or contacts may tie to each; fixed rigid bodies tie nothing."""
    order = [*scene.soft, *scene.rigid]
    numbers: dict[Any, int] = {id(body): number for number, body in enumerate(order)}
    numbers |= {name: numbers[id(body)] for name, body in zip(names, scene.bodies, strict=True)}
    group = np.arange(len(order))
    for tie in (*scene.joints, *scene.contacts):
        ends = [numbers[each if isinstance(each, str) else id(each)] for each in (tie.a, tie.b) if _is_body(each)]
        ends = [number for number in ends if number < len(scene.soft) or loose[number]]
        for other in ends[1:]:
            pair = group[ends[0]], group[other]
            group[(group == pair[0]) | (group == pair[1])] = min(pair)
    return group


def _is_body(partner: object) -> bool:
    return isinstance(partner, str | SoftBody | RigidBody)
