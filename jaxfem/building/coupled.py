"""The coupled part of `build`: rigid bodies, joints and contacts added to a model of soft bodies."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.building.bodies import BodyIndex, rigid_parts
from jaxfem.building.contacts import contact_parts
from jaxfem.building.joint_answers import check_rows
from jaxfem.building.overlaps import warn_of_overlaps
from jaxfem.building.row_groups import joint_parts
from jaxfem.declared import RigidBody, SceneError
from jaxfem.declared.scene import Scene, SoftBody
from jaxfem.elements.mass import is_diagonal
from jaxfem.model import Model, Params, State
from jaxfem.pytrees import on_device


def with_coupling(
    scene: Scene, names: Sequence[str], model: Model, params: Params, state: State
) -> tuple[Model, Params, State]:
    """Model, params and state with all that the scene declares beside soft bodies; unchanged where it declares none.

    `names`: unique names of all bodies, in the scene's order.
    """
    rigid, dtype = scene.rigid, model.rest.dtype
    if not (rigid or scene.joints or scene.contacts):
        return model, params, state
    _check(model, bool(rigid))
    own = [name for name, body in zip(names, scene.bodies, strict=True) if isinstance(body, RigidBody)]
    index = BodyIndex(scene.soft, model.bodies, rigid, own, scene.gravity)
    if rigid:
        bodies, values, start = rigid_parts(rigid, own, index, dtype)
        model, params = model.replace(rigid=bodies), params.replace(rigid=values)
        state = state.replace(rigid=start)
    joints, softness = joint_parts(scene.joints, index, dtype)
    contacts, roughness = contact_parts(scene.contacts, index, dtype)
    model = model.replace(joints=joints, contacts=contacts)
    if rigid and (contacts or any(each.one_sided for each in joints.values())):
        model = model.replace(islands=_islands(scene, index))
    model = model.replace(size=jnp.asarray(_size(model), dtype))
    if model.scheme.restarts:
        model = model.replace(node_group=_tied(scene, index)[model.node_body])
    if contacts:
        warn_of_overlaps(scene.contacts, index, model, roughness, state)
    params = params.replace(joints=softness, contacts=roughness)
    check_rows(model, params)
    return model, params, state


def _size(model: Model) -> float:
    """Length of the scene's largest extent [m], a body's own size (from its inertia) at least."""
    points, own = [np.asarray(model.rest)], 0.0
    if model.rigid is not None:
        points.append(np.asarray(model.rigid.start))
        own = 2 * float(np.sqrt(np.abs(np.asarray(model.rigid.inertia_per_mass)).max()))
    return max(float(np.ptp(np.concatenate(points), axis=0).max()), own)


def _check(model: Model, rigid: bool) -> None:
    if not is_diagonal(model.mass):
        raise SceneError(
            f'mass = "{model.mass}" is for soft bodies alone; rigid bodies, joints and contacts need "lumped"'
        )
    if rigid and not model.scheme.rigid:
        raise SceneError(
            f'scheme "{model.scheme.name}" is for soft bodies; scenes with rigid bodies need "backward_euler"'
        )
    if rigid and not model.bodies and not model.scheme.euler:
        raise SceneError(
            f'scheme "{model.scheme.name}" acts on the nodes of soft bodies, and this scene has rigid ones alone, '
            'which move by the rule of "backward_euler"'
        )


def _tied(scene: Scene, index: BodyIndex) -> jax.Array:
    """A number for each soft body, the same for those that joints or contacts may tie, directly or through others."""
    group = np.arange(len(scene.soft))
    for each in (*scene.joints, *scene.contacts):
        ends = [index.find(body, "a joint or contact") for body in (each.a, each.b) if _is_body(body)]
        tied = [number for kind, number in ends if kind == "soft"]
        for other in tied[1:]:
            group[group == group[other]] = group[tied[0]]
    return on_device(group, jnp.int32)


def _islands(scene: Scene, index: BodyIndex) -> jax.Array:
    """A number for each rigid body, the same for those that joints tie; their count for those tied to soft bodies."""
    count = len(scene.rigid)
    group = np.arange(count)
    moving = [not (body.fixed or body.motion is not None) for body in scene.rigid]
    for joint in scene.joints:
        ends = [index.find(body, "a joint") for body in (joint.a, joint.b) if _is_body(body)]
        numbers = [number for kind, number in ends if kind == "rigid" and moving[number]]
        own = {group[number] for number in numbers}
        if own:
            to = count if any(kind == "soft" for kind, _ in ends) else max(own)
            group[np.isin(group, list(own))] = to
    return on_device(group, jnp.int32)


def _is_body(partner: object) -> bool:
    return isinstance(partner, str | SoftBody | RigidBody)
