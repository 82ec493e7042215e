"""A chain of light links with a heavy end: right at any ratio of masses, though the links' own motion is far too fast
for the step."""

import jax
import numpy as np
import pytest
import scenes

import jaxfem as jf

DT = 1 / 60


def chain(links=10):
    """Links of 1 g along x from the world, and a ball at the end."""
    bodies = [jf.RigidBody(jf.Box((0.1, 0.02, 0.02)), mass=1e-3, position=(0.05 + 0.1 * i, 0, 0)) for i in range(links)]
    bodies.append(jf.RigidBody(jf.Sphere(0.05), mass=1.0, position=(0.1 * links + 0.05, 0, 0)))
    ends = [None, *bodies]
    joints = [jf.BallJoint(ends[i], ends[i + 1], (0.1 * i, 0, 0)) for i in range(links + 1)]
    return jf.Scene(bodies, joints=joints)


@pytest.fixture(scope="module")
def built():
    return jf.build(chain())


@pytest.mark.parametrize("mass", [1.0, 1e2, 1e3, 1e4])
def test_it_swings_as_a_pendulum_does(built, mass):
    model, params, state = built
    masses = params.rigid.mass.at[-1].set(mass)
    params = params.replace(rigid=params.rigid.replace(mass=masses))
    states, infos = scenes.rolled(model, params, state, DT, 60)
    assert not infos.status.any()
    each = jax.vmap(lambda one: jf.energies(model, params, one))(states)
    energy = np.asarray(each.kinetic + each.gravity) / (mass * 9.81)
    assert energy.max() < 1e-2  # m of height; what backward Euler loses on the way down is a tenth of the fall
    assert energy[:24].min() > -0.08
    height = states.rigid.positions[:, -1, 2]
    speed = np.linalg.norm(states.rigid.velocities[:, -1], axis=1)
    fall = slice(5, 20)
    np.testing.assert_allclose(speed[fall], np.sqrt(-2 * 9.81 * height[fall]), rtol=0.1)
    radius = np.linalg.norm(states.rigid.positions[:, -1], axis=1)
    np.testing.assert_allclose(radius[fall], 1.05, atol=5e-3)
