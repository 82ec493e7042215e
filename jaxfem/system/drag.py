"""Mass-proportional damping C = alpha M (Rayleigh 1877), the drag of a medium: a step's masses and targets with it.

With the scheme's v_a = b + follow v the force is -alpha M (b + follow v), so the step's condition
    M (v - v*) + weight alpha M (b + follow v) = J' lam
is that of masses M f with f = 1 + weight alpha follow, and of the target (v* - weight alpha b) / f. alpha is one number
a body, so the same holds of the part of M that is not lumped.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxfem.elements.mass import SharedMass
from jaxfem.materials.constants import MASS_DAMPING
from jaxfem.model import Model, Params
from jaxfem.schemes import Stage

Array = jax.Array


class Dragged(NamedTuple):
    """Fields of a `System` that drag changes."""

    mass: Array
    target: Array
    shared_mass: SharedMass | None
    before: Array | None


def nodal_drag(model: Model, params: Params) -> Array:
    """alpha at each node, (n,) [1/s]; zero without such a constant."""
    if not model.dragged:
        return jnp.zeros_like(model.nodal_volumes)
    alpha = jnp.asarray(params.constants[MASS_DAMPING.name])
    return jnp.broadcast_to(alpha.reshape(-1), (len(model.bodies),))[model.node_body]


def dragged(
    model: Model,
    params: Params,
    stage: Stage,
    mass: Array,
    target: Array,
    shared_mass: SharedMass | None,
    before: Array | None,
) -> Dragged:
    """Masses (n,) [kg], targets (n, 3) [m/s] and the rest of a step's momentum with drag; see the head of this file."""
    alpha = nodal_drag(model, params)[:, None]
    factor = 1 + stage.weight * alpha * stage.follow

    def eased(velocities: Array) -> Array:
        known: Any = 0.0 if stage.before is None else stage.before
        found: Array = (velocities - stage.weight * alpha * known) / factor
        return found

    if shared_mass is not None and before is not None:
        corner = factor[shared_mass.cells[:, 0], 0]
        shared_mass, before = shared_mass.replace(element_mass=shared_mass.element_mass * corner), eased(before)
    return Dragged(mass * factor[:, 0], jnp.where(model.free[:, None] > 0, eased(target), target), shared_mass, before)
