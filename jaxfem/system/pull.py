"""What the pull of joints does to the turning of the bodies that they hold: geometric stiffness, where it must be.

A pull T at an arm r makes a stiffness T r against turning. Taken from the impulses T0 of the last step, where the step
is far too long for the motion it leaves of a turn q off the pull's line
    q1 = q0 (1 - T / T0),
with T the pull that the step finds: that grows where the pull has more than doubled. So where it grows, the step is
solved again with the pull found.
"""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from jaxfem.model import Model
from jaxfem.rows.attachments import Configuration
from jaxfem.rows.locks import Pulling
from jaxfem.system.names import joint_name
from jaxfem.tensors import inverse_blocks

Array = jax.Array

ONSET = 1.0
"""dt^2 |I^-1 K| at which geometric stiffness sets in. Explicit treatment is stable to 4 (Andrews et al. 2017)."""
GROWTH = 1.3
"""Of a body's stiffness by the pull that a step finds over that which it was solved with: more is solved again."""


def pulls(model: Model) -> bool:
    """Whether there are joints whose pull is felt by rigid bodies."""
    return model.rigid is not None and any(isinstance(group, Pulling) for group in model.joints.values())


def pull_grew(
    model: Model,
    inertia: Array,
    before: Mapping[str, Array],
    found: Mapping[str, Array],
    dt: Array,
    at: Configuration,
) -> Array:
    """Whether impulses `found` ask for more stiffness of some body than those `before`; `inertia` (b, 3, 3)."""
    held = jax.lax.stop_gradient((model, inertia, dt, at))
    used, due = (
        jnp.sum(needed_stiffness(held[0], jax.lax.stop_gradient(each), held[1], held[2], held[3]) ** 2, (1, 2))
        for each in (before, found)
    )
    return jnp.any(due > GROWTH**2 * used)


def needed_stiffness(model: Model, pull: Mapping[str, Array], inertia: Array, dt: Array, at: Configuration) -> Array:
    """Geometric stiffness of joints with the impulses `pull` of a step, as far as stability asks for it: (b, 3, 3).

    K (1 - onset / x)+ with x = dt^2 |I^-1 K| (Frobenius): nothing where the step resolves the motion, and elsewhere
    just enough to keep the explicit remainder at the onset.
    """
    total = jnp.zeros_like(inertia)
    for label, group in sorted(model.joints.items()):
        if joint_name(label) in pull and isinstance(group, Pulling):
            total = total + group.tension_stiffness(pull[joint_name(label)] / dt, at)
    ratio = jnp.einsum("bij,bjk->bik", inverse_blocks(inertia), total)
    square = jnp.sum(ratio**2, (1, 2))
    size = dt**2 * jnp.sqrt(jnp.where(square > 0, square, 1))
    share = jnp.where((square > 0) & (size > ONSET), 1 - ONSET / size, 0)
    return share[:, None, None] * total
