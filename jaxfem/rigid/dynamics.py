"""Rigid bodies: poses and velocities, inertia in the world frame, and how they advance in a step.

Turning keeps angular momentum to rounding, and without torque energy too, at any spin (see `turning.py`). A step's
angular velocity is that of its whole turn. What rows change of the free one goes, with the inertia at the pose
predicted for the middle, into the angular momentum; carried to the end of the step, that gives the angular velocity
there by the inertia there.
"""

from dataclasses import field
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.motion import Motion, displaced
from jaxfem.pytrees import Pytree, static
from jaxfem.ranges import Units, ranged, within
from jaxfem.rigid.turning import mean_spin
from jaxfem.rotation import quaternion_from_rotation_vector, quaternion_multiply, quaternion_to_matrix
from jaxfem.tensors import contract, inverse_blocks

Array = jax.Array

UNIT = "must be finite quaternions of length 1, not all zeros: (1, 0, 0, 0) where nothing turns"


class RigidSet(Pytree):
    """What does not change of b rigid bodies.

    `inertia_per_mass` (b, 3, 3) [m^2] about the centre of mass, in the body's frame; `free` (b,) 1 where a body moves
    by its own dynamics, 0 where it is fixed or driven; `start` (b, 3) [m] and `start_orientation` (b, 4): poses that
    motions start from; `driven` (d,): the bodies that follow `RigidParams.motions`, one each; `slender`: numbers of
    those that are so thin that the precision may not tell their spin (see `slender.py`); `isotropic`: whether all that
    turn have the same moment about any axis, as balls and cubes do: their spin stays as it is.
    """

    inertia_per_mass: Array
    free: Array
    start: Array
    start_orientation: Array
    driven: Array
    names: tuple[str, ...] = static()
    slender: tuple[int, ...] = static(default=())
    isotropic: bool = static(default=False)

    @property
    def count(self) -> int:
        """Number of bodies."""
        return self.free.shape[0]


class RigidParams(Pytree):
    """What users differentiate of rigid bodies: `mass` (b,) [kg] (inertia grows with it), and prescribed `motions`."""

    mass: Array = field(metadata=within(low=0, open_low=True))
    motions: tuple[Motion, ...] = field(default=(), metadata=within())


class RigidState(Pytree):
    """Poses and velocities of b rigid bodies, in the world frame.

    `positions` (b, 3) of the centres of mass [m], `orientations` (b, 4) unit quaternions, scalar first (body to world),
    `velocities` (b, 3) [m/s], `angular_velocities` (b, 3) [rad/s].
    """

    positions: Array = field(metadata=within())
    orientations: Array = field(metadata=ranged(Units(advice=UNIT)))
    velocities: Array = field(metadata=within())
    angular_velocities: Array = field(metadata=within())


def world_inertia(bodies: RigidSet, mass: Array, orientations: Array) -> Array:
    """Inertia R I R' in the world frame, (b, 3, 3) [kg m^2]."""
    turn = quaternion_to_matrix(orientations)
    return mass[:, None, None] * contract("bij,bjk,blk->bil", turn, bodies.inertia_per_mass, turn)


def turned(orientations: Array, rotation: Array) -> Array:
    """Orientations (b, 4) after a rotation by the vectors (b, 3) [rad] in the world frame; of unit length."""
    product = quaternion_multiply(quaternion_from_rotation_vector(rotation), orientations)
    unit: Array = product / jnp.linalg.norm(product, axis=-1, keepdims=True)
    return unit


def midway(bodies: RigidSet, state: RigidState, dt: Array) -> Array:
    """Orientations (b, 4) predicted for the middle of the step."""
    return turned(state.orientations, 0.5 * dt * state.angular_velocities)


def free_spin(bodies: RigidSet, state: RigidState, dt: Array) -> Array:
    """Angular velocities (b, 3) along which bodies turn in a step without torque."""
    if bodies.isotropic:
        return state.angular_velocities
    rotations = quaternion_to_matrix(state.orientations)
    return mean_spin(bodies.inertia_per_mass, rotations, state.angular_velocities, dt)


def angular_momentum(bodies: RigidSet, mass: Array, state: RigidState) -> Array:
    """Spin I w of each body, (b, 3) [kg m^2/s]; in the body's frame, where moments that are far apart stay so."""
    turn = quaternion_to_matrix(state.orientations)
    own = contract("bji,bj->bi", turn, state.angular_velocities)
    return mass[:, None] * contract("bij,bj->bi", turn, contract("bij,bj->bi", bodies.inertia_per_mass, own))


def _spin_of(bodies: RigidSet, mass: Array, orientations: Array, momentum: Array) -> Array:
    """Angular velocities (b, 3) of bodies with that angular `momentum` (b, 3): its inverse to rounding, not beside it.

    An inverse that is rounded once for all, or turns that are not quite turns, would take or give a share each step.
    """
    back, inertia = inverse_blocks(quaternion_to_matrix(orientations)), bodies.inertia_per_mass
    inverse = inverse_blocks(inertia)
    own = contract("bij,bj->bi", back, momentum) / mass[:, None]
    spin = contract("bij,bj->bi", inverse, own)
    spin = spin + contract("bij,bj->bi", inverse, own - contract("bij,bj->bi", inertia, spin))
    return contract("bji,bj->bi", back, spin)


def advanced(
    bodies: RigidSet,
    mass: Array,
    state: RigidState,
    linear: Array,
    angular: Array,
    dt: Array,
    passed: Array | None = None,
    spin: Array | None = None,
) -> RigidState:
    """The state after a step whose solved velocities are `linear` and `angular` (b, 3).

    `passed` (b,): share of the step in which bodies go on as they did before, until they are struck; None: no body is.
    `spin` (b, 3): `free_spin` of the step.
    """
    spin = free_spin(bodies, state, dt) if spin is None else spin
    middle = world_inertia(bodies, mass, midway(bodies, state, dt))
    change = contract("bij,bj->bi", middle, angular - spin)
    momentum = angular_momentum(bodies, mass, state) + change
    along, turning = linear, angular
    if passed is not None:
        share = (passed * bodies.free)[:, None]
        along = along + share * (state.velocities - along)
        turning = turning + share * (state.angular_velocities - turning)
    orientations = turned(state.orientations, dt * turning)
    after = _spin_of(bodies, mass, orientations, momentum)
    return RigidState(
        positions=state.positions + dt * along,
        orientations=orientations,
        velocities=linear,
        angular_velocities=jnp.where(bodies.free[:, None] > 0, after, angular),
    )


def prescribed_velocities(
    bodies: RigidSet, motions: tuple[Motion, ...], state: RigidState, time: Array, dt: Array
) -> tuple[Array, Array]:
    """Velocities (b, 3), (b, 3) that bring driven bodies to their pose at the end of the step; zero on all others."""
    linear, angular = jnp.zeros_like(state.positions), jnp.zeros_like(state.positions)
    for number, motion in enumerate(motions):
        body = bodies.driven[number]
        place = displaced(motion, bodies.start[body][None], time + dt)[0]
        turn = quaternion_from_rotation_vector(motion.angular_velocity * (time + dt))
        wanted = quaternion_multiply(turn, bodies.start_orientation[body])
        linear = linear.at[body].set((place - state.positions[body]) / dt)
        angular = angular.at[body].set(rotation_between(state.orientations[body], wanted) / dt)
    return linear, angular


def rotation_between(first: Array, second: Array) -> Array:
    """Rotation vector (..., 3) [rad] in the world frame that takes orientation `first` to `second`; at most pi long."""
    across = quaternion_multiply(second, first * jnp.array([1.0, -1.0, -1.0, -1.0], first.dtype))
    scalar, vector = across[..., :1], across[..., 1:]
    flipped = jnp.where(scalar < 0, -1, 1)
    square = jnp.sum(vector**2, -1, keepdims=True)
    small = square < 1e-12
    size = jnp.sqrt(jnp.where(small, 1, square))
    # 2 atan2(|v|, |w|) / |v|, by its series where |v| is small
    ratio = jnp.where(small, 2 + square / 3, 2 * jnp.arctan2(size, jnp.abs(scalar)) / size)
    return flipped * ratio * vector


def rigid_energies(bodies: RigidSet, params: Any, gravity: Array, state: RigidState) -> tuple[Array, Array]:
    """Kinetic energy and potential in gravity, zero at the start's places [J]."""
    spin = angular_momentum(bodies, params.mass, state)
    kinetic = 0.5 * jnp.sum(params.mass[:, None] * state.velocities**2) + 0.5 * jnp.sum(spin * state.angular_velocities)
    return kinetic, -jnp.sum(params.mass[:, None] * gravity * (state.positions - bodies.start))
