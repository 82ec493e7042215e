"""Spins that a precision cannot tell: those of bodies so thin that they have next to no inertia about their axis.

Turned into the body's frame, the angular momentum P is known to a share e of all of it, the precision times the turn of
the step in radians where that is more than one. About an axis of the small moment J that is a spin of e |P| / J, and
what the step leaves of it goes on into the next one: measured on needles, 2000 steps in single precision, energy is
lost and found where e |P| / (J |w|) is above some hundredths, and a thousand times its start's above some tenths.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.rigid.dynamics import RigidSet, RigidState
from jaxfem.rotation import quaternion_to_matrix
from jaxfem.solvers.status import Status, caused
from jaxfem.tensors import contract, inverse_blocks

Array = jax.Array

APART = 1e-4
"""Times the precision, of ratios of moments: below that no spin needs looking at."""
TOLD = 0.01
"""Of a spin: how far it may be off by rounding."""
TURNING = 1e-3
"""rad in a step: what turns less is at rest."""


def slender(inertias: np.ndarray, free: np.ndarray, dtype: Any) -> tuple[int, ...]:
    """The free bodies whose moments of inertia, of `inertias` (b, 3, 3), are far enough apart; host side."""
    moments = np.linalg.eigvalsh(inertias)
    return tuple(int(k) for k in np.flatnonzero(free & (moments[:, -1] * np.finfo(dtype).eps > APART * moments[:, 0])))


def slender_status(bodies: RigidSet, state: RigidState | None, dt: Array, status: Array) -> Array:
    """The status given, or where it is 0 that of a slender body, by name, whose spin is not told; `state`: after it."""
    if not bodies.slender or state is None:
        return status
    which = np.array(bodies.slender)
    inertia, turns, spin = jax.lax.stop_gradient(
        (bodies.inertia_per_mass[which], state.orientations[which], state.angular_velocities[which])
    )
    own = contract("bji,bj->bi", quaternion_to_matrix(turns), spin)
    momentum = jnp.linalg.norm(contract("bij,bj->bi", inertia, own), axis=-1)
    size = jnp.linalg.norm(spin, axis=-1)
    unknown = jnp.finfo(size.dtype).eps * jnp.maximum(dt * size, 1) * momentum
    most = jnp.trace(inverse_blocks(inertia), axis1=1, axis2=2)
    lost = (unknown * most > TOLD * size) & (dt * size > TURNING)
    codes = jnp.asarray(np.array([_code(bodies.names[k]) for k in bodies.slender], np.int32))
    blurred = jnp.any(lost) & (status == int(Status.CONVERGED))
    return jnp.where(blurred, codes[jnp.argmax(lost)], status).astype(jnp.int32)


def _code(name: str) -> int:
    why = "its moments of inertia are too far apart for this precision"
    return caused(Status.UNRESOLVED_SPIN, f'that of "{name}", {why}: compute in double precision, or make it thicker')
