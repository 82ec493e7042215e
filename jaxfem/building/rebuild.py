"""rebuild: a model for other rest positions of the same scene; pure, and differentiable in them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.declared.errors import SceneError
from jaxfem.elements.reshaping import reshaped_domains, reshaped_elements, reshaped_nodal_volumes
from jaxfem.model import Model
from jaxfem.rotation import quaternion_to_matrix
from jaxfem.rows.attachments import Reshaping

Array = jax.Array


def rebuild(model: Model, rest: Any) -> Model:
    """The model of the same scene with its nodes at `rest` (n, 3) [m], undeformed there; `model.rest` has them now.

    Pure: to be called inside `jax.grad`, `jit` and `vmap` too. All that comes of the rest shape follows, with true
    derivatives: volumes and masses, strains of every kind, areas of tractions. What was declared in soft bodies rides
    with their elements: anchors of joints (whose other ends come along, so that they are closed at the start), points
    of loads, vertices of contact surfaces; fixed nodes are where the state has them. What is no shape stays: topology,
    names, lengths of ropes, contact margins, mesh quality unseen. The state does not follow: begin with
    `state.replace(positions=rest)`, or with another state for a body that starts strained. What `prepare` had made is
    dropped. An element that `rest` turns inside out is refused, inside jit with a status. SceneError for what cannot
    follow.
    """
    if not isinstance(model, Model):
        raise SceneError(f"rebuild takes the model that build returned, not a {type(model).__name__}")
    shape = jnp.shape(rest)
    if shape != model.rest.shape:
        raise SceneError(f"rest has shape {shape}; give one place in m for each node of the model, {model.rest.shape}")
    if not model.bodies:
        raise SceneError("the scene holds no soft body, so that it has no rest shape: rigid bodies' poses are in state")
    for number, load in enumerate(model.loads):
        if not callable(getattr(load, "reshaped", None)):
            raise SceneError(
                f"load {number}, a {type(load).__name__}, does not say how it follows the rest shape: give it a method "
                "`reshaped(rest)` (jaxfem/loads.py)"
            )
    made: Model = _rebuilt(model.replace(cache=None), jnp.asarray(rest, model.rest.dtype))
    if not isinstance(made.elements.volumes, jax.core.Tracer):
        _check(made)
    return made


@jax.jit
def _rebuilt(model: Model, rest: Array) -> Model:
    elements = reshaped_elements(model.elements, rest)
    turns = jnp.zeros((0, 3, 3), rest.dtype)
    if model.rigid is not None:
        turns = quaternion_to_matrix(model.rigid.start_orientation)
    change = Reshaping(model.rest, rest, turns)
    made: Model = model.replace(
        rest=rest,
        elements=elements,
        domains=reshaped_domains(model.domains, model.elements, elements),
        nodal_volumes=reshaped_nodal_volumes(elements, model.nodes),
        loads=tuple(load.reshaped(rest) for load in model.loads),
        joints={label: rows.reshaped(change) for label, rows in model.joints.items()},
        reshaped=True,
    )
    return made


def _check(model: Model) -> None:
    volumes = np.asarray(model.elements.volumes)
    bad = np.flatnonzero(~(volumes > 0))
    if len(bad):
        body = model.bodies[int(model.elements.body[bad[0]])]
        raise SceneError(
            f'rest turns element {bad[0]} of "{body}" inside out, or flat ({volumes[bad[0]]:.2g} m^3; '
            f"{len(bad)} of {len(volumes)} elements): move the nodes less, or the inner ones along"
        )
