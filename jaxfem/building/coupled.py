"""The coupled part of `build`: rigid bodies, joints and contacts added to a model of soft bodies."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.building.bodies import BodyIndex, rigid_parts
from jaxfem.building.contacts import contact_parts
from jaxfem.building.row_groups import joint_parts
from jaxfem.declared import RigidBody, SceneError
from jaxfem.declared.scene import Scene, SoftBody
from jaxfem.methods.allrows.factor import elimination_of
from jaxfem.methods.nodes.row_stiffness import MOST_EXACT
from jaxfem.model import Model, Params, State
from jaxfem.system.coupled import coupled_system
from jaxfem.system.soft import extra_rows


def with_coupling(
    scene: Scene, names: Sequence[str], model: Model, params: Params, state: State, choose: bool = False
) -> tuple[Model, Params, State]:
    """Model, params and state with all that the scene declares beside soft bodies; unchanged where it declares none.

    `names`: unique names of all bodies, in the scene's order. `choose`: the solver is for this function to choose.
    """
    rigid, dtype, asked = scene.rigid, model.rest.dtype, model.solver
    if not (rigid or scene.joints or scene.contacts):
        if model.solver in ("direct", "pgs"):
            raise SceneError(
                f'solver "{model.solver}" is for scenes with rigid bodies, joints or contacts: use "auto" here'
            )
        return model, params, state
    own = [name for name, body in zip(names, scene.bodies, strict=True) if isinstance(body, RigidBody)]
    index = BodyIndex(scene.soft, model.bodies, rigid, own)
    if rigid:
        bodies, values, start = rigid_parts(rigid, own, index, dtype)
        model, params = model.replace(rigid=bodies), params.replace(rigid=values)
        state = state.replace(rigid=start)
    if model.mass != "lumped":
        raise SceneError(
            f'mass = "{model.mass}" is for soft bodies alone; rigid bodies, joints and contacts need "lumped"'
        )
    if model.scheme != "backward_euler" and rigid:
        raise SceneError(f'scheme "{model.scheme}" is for soft bodies; scenes with rigid bodies need "backward_euler"')
    if model.rotations != "explicit":
        raise SceneError('rotations = "implicit" is for soft bodies alone, without rigid bodies, joints or contacts')
    if model.solver == "pgs" and any(body.strain != "element" for body in scene.soft):
        raise SceneError('solver "pgs" visits rows of single elements: use strain = "element", or another solver')
    joints, softness = joint_parts(scene.joints, index, dtype)
    contacts, roughness = contact_parts(scene.contacts, index, dtype)
    model = model.replace(
        joints=joints,
        contacts=contacts,
        solver=_solver("mprgp" if asked == "direct" else asked, bool(scene.soft and (joints or contacts))),
    )
    if model.scheme != "backward_euler":
        model = model.replace(node_group=_tied(scene, index)[model.node_body])
    params = params.replace(joints=softness, contacts=roughness)
    # Dolls of many rigid bodies and few nodes: the condensed route preconditions by the nodes.
    most = min(MOST_EXACT, 2 * model.nodes)
    if choose and model.solver == "condensed" and rigid and _across(model, params, state) > most:
        model = model.replace(solver="mprgp")
    model = _with_elimination(model, params, state, asked)
    return model, params, state.replace(impulses=_no_impulses(model, params, state))


def _solver(asked: str, mixed: bool) -> str:
    """The condensed route is for elastic rows beside others; without either, all rows are solved for."""
    return "mprgp" if asked == "condensed" and not mixed else asked


def _tied(scene: Scene, index: BodyIndex) -> jax.Array:
    """A number for each soft body, the same for those that joints or contacts may tie, directly or through others."""
    group = np.arange(len(scene.soft))
    for each in (*scene.joints, *scene.contacts):
        ends = [index.find(body, "a joint or contact") for body in (each.a, each.b) if _is_body(body)]
        tied = [number for kind, number in ends if kind == "soft"]
        for other in tied[1:]:
            group[group == group[other]] = group[tied[0]]
    return jnp.asarray(group, jnp.int32)


def _is_body(partner: object) -> bool:
    return isinstance(partner, str | SoftBody | RigidBody)


def _across(model: Model, params: Params, state: State) -> int:
    """Number of rows that couple several triples: more than few, and the condensed route preconditions them badly."""
    bare, step = state.replace(impulses=None), jnp.ones((), model.rest.dtype)
    system = jax.eval_shape(lambda: coupled_system(model, params, bare, step))
    return sum(rows.bias.size for rows in extra_rows(system) if rows.triples.shape[1] > 1)


def _with_elimination(model: Model, params: Params, state: State, asked: str) -> Model:
    """The model with the order of its elimination and solver "direct", where that is asked for or better."""
    if asked not in ("condensed", "direct"):
        return model
    order = None
    if not model.domains and model.rigid is not None:
        triples = jax.jit(_triples)(model, params, state)  # nothing but these is compiled
        order = elimination_of([np.asarray(each) for each in triples], _no_impulses(model, params, state), model.rigid)
    if order is not None:
        return model.replace(elimination=order, solver="direct")
    if asked == "direct":
        raise SceneError(
            'solver "direct" eliminates the rows of rigid bodies: this scene has soft bodies or nothing that ties its '
            'rigid ones, or so many ties that elimination is too dear. Use "auto", "mprgp" or "pgs"'
        )
    return model


def _triples(model: Model, params: Params, state: State) -> tuple:
    """Triples that each kind of rows acts on."""
    system = coupled_system(model, params, state, jnp.ones((), model.rest.dtype))
    return tuple(rows.triples for rows in extra_rows(system))


def _no_impulses(model: Model, params: Params, state: State) -> tuple:
    """Zero impulses of all rows of a step, in their shapes; None for those that the solver eliminates."""
    bare = state.replace(impulses=None)
    step = jnp.ones((), model.rest.dtype)
    shapes = jax.eval_shape(lambda: tuple(rows.bias for rows in coupled_system(model, params, bare, step).rows))
    eliminated = len(model.domains) if model.solver == "condensed" else 0
    zeros = tuple(jnp.zeros(each.shape, each.dtype) for each in shapes)
    return (*(None,) * eliminated, *zeros[eliminated:])
