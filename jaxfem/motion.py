"""Prescribed motion of nodes as a function of time, with differentiable numbers."""

from dataclasses import field
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.materials.quantities import positive, signed
from jaxfem.pytrees import Pytree
from jaxfem.ranges import within
from jaxfem.rotation import rotation_vector_to_matrix
from jaxfem.tensors import matmul

Array = jax.Array


class Motion(Pytree):
    """Motion of a driven set of nodes: u(t) = velocity t + amplitude (sin(2 pi f t + phase) - sin(phase)), and a turn.

    `velocity` (3,) [m/s], `amplitude` (3,) [m], `frequency` [Hz], `phase` [rad], `angular_velocity` (3,) [rad/s] about
    the point `center` (3,) [m]. All zero: the nodes are held where they are.
    """

    velocity: Any = field(default=(0.0, 0.0, 0.0), metadata=within() | signed("velocity", "m/s", "velocity"))
    amplitude: Any = field(default=(0.0, 0.0, 0.0), metadata=within() | signed("amplitude", "m", "amplitude"))
    frequency: Any = field(default=0.0, metadata=within() | positive("frequency", "Hz", "frequency"))
    phase: Any = field(default=0.0, metadata=within() | signed("phase", "rad", "phase"))
    angular_velocity: Any = field(
        default=(0.0, 0.0, 0.0), metadata=within() | signed("angular_velocity", "rad/s", "angular velocity")
    )
    center: Any = field(default=(0.0, 0.0, 0.0), metadata=within() | signed("center", "m", "centre of the turn"))


def displaced(motion: Motion, rest: Array, time: Array) -> Array:
    """Where `motion` puts points that start at `rest` (k, 3) at `time` [s]: (k, 3)."""
    turn = rotation_vector_to_matrix(motion.angular_velocity * time)
    angle = 2 * jnp.pi * motion.frequency * time + motion.phase
    shift = motion.velocity * time + motion.amplitude * (jnp.sin(angle) - jnp.sin(motion.phase))
    moved: Array = motion.center + matmul(rest - motion.center, turn.T) + shift
    return moved
