"""What the pull of joints does to the turning of the bodies that they hold: geometric stiffness, where it must be.

A pull T at an arm r makes a stiffness T r against turning. In a step, with the stiffness K as far as stability asks for
it (`needed_stiffness`), it leaves of a turn q off the pull's line
    q1 = q0 (1 - x / max(1, x0)),    x = dt^2 |I^-1 K|,
x0 by the impulses of the last step, x by those that the step finds: that grows where the pull has more than doubled. So
where it comes near, the step is solved again with the pull found.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from jaxfem.model import Model
from jaxfem.rows.attachments import Configuration
from jaxfem.rows.locks import Pulling
from jaxfem.system.names import joint_name
from jaxfem.tensors import contract, inverse_blocks

Array = jax.Array

ONSET = 1.0
"""dt^2 |I^-1 K| at which geometric stiffness sets in. Explicit treatment is stable to 4 (Andrews et al. 2017)."""
GROWTH = 1.7
"""x / max(1, x0) of a body beyond which a step is solved again: at 2 a turn off the line swings on for ever."""


def pulls(model: Model) -> bool:
    """Whether there are joints whose pull is felt by rigid bodies."""
    return model.rigid is not None and any(isinstance(group, Pulling) for group in model.joints.values())


def pull_grew(
    model: Model, inertia: Array, before: Array, found: Mapping[str, Array], dt: Array, at: Configuration
) -> Array:
    """Whether impulses `found` pull some body so much harder than x (b,) `before`; `inertia` (b, 3, 3)."""
    _, due = _stiffness(model, *jax.lax.stop_gradient((found, inertia, dt, at)))
    return jnp.any(due > GROWTH * jnp.maximum(ONSET, jax.lax.stop_gradient(before)))


def needed_stiffness(
    model: Model, pull: Mapping[str, Array], inertia: Array, dt: Array, at: Configuration
) -> tuple[Array, Array]:
    """Geometric stiffness of joints with the impulses `pull` of a step, as far as stability asks for it: (b, 3, 3).

    K (1 - onset / x)+ with x = dt^2 |I^-1 K| (Frobenius): nothing where the step resolves the motion, and elsewhere
    just enough to keep the explicit remainder at the onset. And x (b,).
    """
    total, size = _stiffness(model, pull, inertia, dt, at)
    share = jnp.where(size > ONSET, 1 - ONSET / jnp.where(size > ONSET, size, 1), 0)
    return share[:, None, None] * total, size


def _stiffness(
    model: Model, pull: Mapping[str, Array], inertia: Array, dt: Array, at: Configuration
) -> tuple[Array, Array]:
    """K (b, 3, 3) of the impulses `pull` of a step, and x = dt^2 |I^-1 K| (b,)."""
    total = jnp.zeros_like(inertia)
    for label, group in sorted(model.joints.items()):
        if joint_name(label) in pull and isinstance(group, Pulling):
            total = total + group.tension_stiffness(pull[joint_name(label)] / dt, at)
    ratio = contract("bij,bjk->bik", inverse_blocks(inertia), total)
    square = jnp.sum(ratio**2, (1, 2))
    return total, jnp.where(square > 0, dt**2 * jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
