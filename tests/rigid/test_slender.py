"""Needles that spin: their momentum and energy are kept as far as the precision goes, and a status says where not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.rigid.dynamics import angular_momentum
from jaxfem.rotation import quaternion_to_matrix
from jaxfem.solvers import Status, describe

DT, STEPS = 1 / 60, 1000


def spun(ratio, dtype, spin):
    """Relative changes of energy and of angular momentum of a needle with moments `ratio` apart, and the statuses."""
    moments = np.array([1e-2 / ratio, 1e-2, 1e-2])
    box = jf.RigidBody(
        jf.Box((0.1, 0.1, 0.1)), mass=1.0, inertia=np.diag(moments), angular_velocity=spin, name="needle"
    )
    model, params, state = jf.build(jf.Scene([box], gravity=(0, 0, 0)), dtype=dtype)
    states, info = jf.rollout(model, params, state, DT, STEPS, every=STEPS)

    def measured(rigid):
        turn, spin = quaternion_to_matrix(rigid.orientations), rigid.angular_velocities
        own = np.asarray(turn, float)[0].T @ np.asarray(spin, float)[0]
        return 0.5 * moments @ own**2, np.asarray(angular_momentum(model.rigid, params.rigid.mass, rigid), float)[0]

    before, after = measured(state.rigid), measured(jax.tree.map(lambda leaf: leaf[-1], states.rigid))
    momentum = np.linalg.norm(after[1] - before[1]) / np.linalg.norm(before[1])
    return abs(after[0] / before[0] - 1), momentum, int(info.status[0])


@pytest.mark.parametrize("ratio", [10, 1e3, 1e5])
def test_spins_about_thin_axes_are_kept_in_single_precision(ratio):
    """Energy was 680 times its start's at a ratio of 1e6, and 2 % off at 1e4."""
    energy, momentum, status = spun(ratio, jnp.float32, (1000.0, 1.0, 0.0))
    assert status == 0 and energy < 3e-3 and momentum < 5e-3


def test_moments_nine_orders_apart_are_kept_in_double_precision():
    energy, momentum, status = spun(1e9, jnp.float64, (1000.0, 1.0, 0.0))
    assert status == 0 and energy < 1e-8 and momentum < 1e-10


@pytest.mark.parametrize(("ratio", "spin"), [(1e4, 1000.0), (1e6, 10.0)])
def test_what_the_precision_cannot_tell_has_a_status(ratio, spin):
    _, _, status = spun(ratio, jnp.float32, (spin, spin, 0.0))
    assert Status(status) is Status.UNRESOLVED_SPIN and 'that of "needle"' in describe(status)


def test_a_needle_at_rest_has_none():
    assert spun(1e6, jnp.float32, (0.0, 1e-3, 0.0))[2] == 0
