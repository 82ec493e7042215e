"""What free bodies keep, with lanes last: see `system/momentum.py`, whose equations these are, of soft bodies alone."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.model import Model
from jaxfem.rotation import quaternion_from_rotation_vector, quaternion_to_matrix
from jaxfem.solvers.status import Status
from jaxfem.sweeping.lanes.kernels import cross
from jaxfem.sweeping.lanes.loose import Loose
from jaxfem.system.momentum import FAR, TOO_FAR, turning_code

Array = jax.Array


def angles(of: Loose, mass: Array, places: Array, velocities: Array, dt: Array) -> Array:
    """Rotation vectors (b, 3, lanes) of each body's turn as a whole in a step, zero where something holds it."""
    arm = _arms(of, mass, places)
    spin = _spins(_inertia(of, mass, arm), _sums(of.nodes, mass * cross(arm, velocities)))
    return dt * spin * of.loose[:, :, None]


def turns_ahead(angle: Array) -> Array:
    """By how much rotations are those of the step's end, (b, 3, 3, lanes): as `system.momentum.turns_ahead`."""
    square = (angle**2).sum(1, keepdims=True)
    size = jnp.sqrt(jnp.where(square > 0, square, 1))
    share = jnp.where(square > 0, jnp.clip(size / FAR - 1, 0, 1), 0)
    vector = jnp.moveaxis(share * angle, 1, -1)
    turned: Array = jnp.moveaxis(quaternion_to_matrix(quaternion_from_rotation_vector(vector)), 1, -1)
    return turned


def turning_status(model: Model, angle: Array, status: Array) -> Array:
    """The status (lanes,) given, or where it is 0 that of a body which turns too far."""
    size = jnp.sqrt((jax.lax.stop_gradient(angle) ** 2).sum(1))
    codes = jnp.asarray(np.array([turning_code(name) for name in model.bodies], np.int32))
    far = (size.max(0) > TOO_FAR[model.scheme.straight]) & (status == int(Status.CONVERGED))
    return jnp.where(far, codes[jnp.argmax(size, 0)], status).astype(jnp.int32)


def kept(of: Loose, mass: Array, places: Array, velocities: Array, defect: Array, straight: bool) -> Array:
    """Velocities (n, 3, lanes) with the momentum that free bodies keep; `defect` (n, 3, lanes): M (v - v*)."""
    change = _spread(of.nodes, -_sums(of.nodes, defect) / _sums(of.nodes, mass) * of.loose[:, :, None])
    if straight:
        arm = _arms(of, mass, places)
        torque = _sums(of.nodes, cross(arm, defect))
        spin = -_spins(_inertia(of, mass, arm), torque) * of.loose[:, :, None]
        change = change + cross(_spread(of.nodes, spin), arm)
    return velocities + change


def of_nodes(of: Loose, values: Array) -> Array:
    """Each node's own of values (b, ..., lanes) of the bodies, (n, ..., lanes)."""
    return _spread(of.nodes, values)


def of_elements(of: Loose, values: Array) -> Array:
    """Each element's own, (E + 1, ..., lanes)."""
    return _spread(of.elements, values)


def _sums(member: Array, values: Array) -> Array:
    """Sums over each body's (b, ..., lanes) of values (n, ..., lanes)."""
    if len(member) == 1:
        return values.sum(0, keepdims=True)
    return jnp.stack([(row.reshape(-1, *(1,) * (values.ndim - 1)) * values).sum(0) for row in member])


def _spread(member: Array, values: Array) -> Array:
    if len(member) == 1:
        return values
    rows = [row.reshape(-1, *(1,) * (values.ndim - 1)) * value for row, value in zip(member, values, strict=True)]
    found: Array = sum(rows[1:], start=rows[0])
    return found


def _arms(of: Loose, mass: Array, places: Array) -> Array:
    return places - _spread(of.nodes, _sums(of.nodes, mass * places) / _sums(of.nodes, mass))


def _inertia(of: Loose, mass: Array, arm: Array) -> Array:
    """About the centres of mass, (b, 3, 3, lanes): sums of m (|a|^2 I - a a')."""
    eye = jnp.eye(3, dtype=arm.dtype)[..., None]
    square = (arm**2).sum(1)[:, None, None]
    return _sums(of.nodes, mass[:, None] * (square * eye - arm[:, :, None] * arm[:, None]))


def _spins(inertia: Array, torque: Array) -> Array:
    """inertia^-1 torque (b, 3, lanes), with next to nothing about axes that a body has no extent around; L D L'."""
    size = (inertia[:, 0, 0] + inertia[:, 1, 1] + inertia[:, 2, 2])[:, None, None]
    more = jnp.where(size > 0, 100 * jnp.finfo(size.dtype).eps * size, 1)
    m = inertia + more * jnp.eye(3, dtype=size.dtype)[..., None]
    first, one, two = m[:, 0, 0], m[:, 0, 1] / m[:, 0, 0], m[:, 0, 2] / m[:, 0, 0]
    second, across = m[:, 1, 1] - one * m[:, 0, 1], m[:, 1, 2] - one * m[:, 0, 2]
    third = m[:, 2, 2] - two * m[:, 0, 2] - across / second * across
    y = torque[:, 1] - one * torque[:, 0]
    z2 = (torque[:, 2] - two * torque[:, 0] - across / second * y) / third
    z1 = (y - across * z2) / second
    return jnp.stack([torque[:, 0] / first - one * z1 - two * z2, z1, z2], 1)
