"""The rigid part of bodies' motion: centres, inertia, spins and turns of each; one place for a step and for lanes.

Values stand by point or by body along axis 0, by component along axis 1 (matrices: 1 and 2); lanes, if any, come last.
Who belongs to which body is asked of `Members`.
"""

from collections.abc import Sequence
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.rotation import quaternion_from_rotation_vector, quaternion_to_matrix
from jaxfem.solvers.status import Status, caused

Array = jax.Array

FAR = 0.01
"""rad in a step: what turns less has the rotations of its start, what turns twice as far those of its end."""
TOO_FAR = {True: 0.25, False: 0.12}
"""rad in a step: a free body that turns further gains a twentieth of its energy and more, at a radian all bounds are
lost; of schemes whose positions move straight along the new velocities, and of others."""
CYCLES = ((1, 2), (2, 0), (0, 1))


class Members(Protocol):
    """Which points belong to which bodies."""

    def sums(self, values: Array) -> Array:
        """Sums over each body (b, ...) of values (n, ...) of the points."""
        ...

    def spread(self, values: Array, points: int) -> Array:
        """Each of the first `points`' own of values (b, ...) of the bodies."""
        ...


def cross(a: Array, b: Array) -> Array:
    """Cross products along axis 1."""
    return jnp.stack([a[:, i] * b[:, j] - a[:, j] * b[:, i] for i, j in CYCLES], 1)


def divided(values: Array, mass: Array) -> Array:
    """values / mass, also of bodies without any."""
    return values / jnp.where(mass > 0, mass, 1)


def arms(of: Members, mass: Array, places: Array) -> Array:
    """From the bodies' centres of mass to their points (n, 3); `mass` (n, 1)."""
    return places - of.spread(divided(of.sums(mass * places), of.sums(mass)), places.shape[0])


def inertia(of: Members, mass: Array, arm: Array) -> Array:
    """About the centres of mass, (b, 3, 3): sums of m (|a|^2 I - a a')."""
    eye = jnp.eye(3, dtype=arm.dtype).reshape(1, 3, 3, *(1,) * (arm.ndim - 2))
    square = (arm**2).sum(1)[:, None, None]
    return of.sums(mass[:, None] * (square * eye - arm[:, :, None] * arm[:, None]))


def spins(inertia: Array, torque: Array) -> Array:
    """inertia^-1 torque (b, 3), with next to nothing about axes that a body has no extent around; by L D L'."""
    size = inertia[:, 0, 0] + inertia[:, 1, 1] + inertia[:, 2, 2]
    more = jnp.where(size > 0, 100 * jnp.finfo(size.dtype).eps * size, 1)
    first = inertia[:, 0, 0] + more
    one, two = inertia[:, 0, 1] / first, inertia[:, 0, 2] / first
    second, across = inertia[:, 1, 1] + more - one * inertia[:, 0, 1], inertia[:, 1, 2] - one * inertia[:, 0, 2]
    third = inertia[:, 2, 2] + more - two * inertia[:, 0, 2] - across / second * across
    y = torque[:, 1] - one * torque[:, 0]
    z = (torque[:, 2] - two * torque[:, 0] - across / second * y) / third
    y = (y - across * z) / second
    return jnp.stack([torque[:, 0] / first - one * y - two * z, y, z], 1)


def angles(of: Members, mass: Array, places: Array, velocities: Array, dt: Array) -> Array:
    """Rotation vectors (b, 3) of each body's turn as a whole in a step."""
    arm = arms(of, mass, places)
    return dt * spins(inertia(of, mass, arm), of.sums(mass * cross(arm, velocities)))


def turns_ahead(angle: Array) -> Array:
    """By how much rotations are those of the step's end, (b, 3, 3), of bodies that turn by `angle` (b, 3).

    Rotations of the start leave a turn's chord for its arc, that is a strain of half its square, which feeds energy to
    a spin. Those of the end are known ahead for its rigid part, so a step stays linear.
    """
    square = (angle**2).sum(1, keepdims=True)
    size = jnp.sqrt(jnp.where(square > 0, square, 1))
    share = jnp.where(square > 0, jnp.clip(size / FAR - 1, 0, 1), 0)
    vector = jnp.moveaxis(share * angle, 1, -1)
    turned: Array = quaternion_to_matrix(quaternion_from_rotation_vector(vector))
    return jnp.moveaxis(turned, (-2, -1), (1, 2))


def turning_status(bodies: Sequence[str], straight: bool, angle: Array, status: Array) -> Array:
    """The status given, or where it is 0 that of one of the `bodies`, by name, which turns too far in the step."""
    size = jnp.sqrt((jax.lax.stop_gradient(angle) ** 2).sum(1))
    codes = jnp.asarray(np.array([turning_code(name) for name in bodies], np.int32))
    far = (size.max(0) > TOO_FAR[straight]) & (status == int(Status.CONVERGED))
    return jnp.where(far, codes[jnp.argmax(size, 0)], status).astype(jnp.int32)


def turning_code(name: str) -> int:
    """The status of a step in which the body `name` turns too far."""
    return caused(Status.TURNED_TOO_FAR, f'"{name}", which gains energy by it: take a smaller time step')
