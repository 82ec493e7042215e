"""Balls and cubes, whose spin stays as it is, hold nothing of the integrator of others and move as by it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

CUBE, BRICK = jf.Box((0.2, 0.2, 0.2)), jf.Box((0.2, 0.2, 0.1))


def sliding(shape):
    body = jf.RigidBody(shape, mass=1.0, position=(0, 0, 0.11), velocity=(1.0, 0.2, 0), angular_velocity=(3.0, 20, 1))
    return jf.build(jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=0.3)]), tolerance=1e-10)


@pytest.mark.parametrize(
    ("bodies", "isotropic"),
    [
        ([jf.RigidBody(jf.Sphere(0.1), mass=1.0), jf.RigidBody(CUBE, mass=1.0, orientation=(1, 0.3, 0.2, 0))], True),
        ([jf.RigidBody(CUBE, mass=1.0), jf.RigidBody(BRICK, mass=1.0, fixed=True)], True),
        ([jf.RigidBody(CUBE, mass=1.0), jf.RigidBody(BRICK, mass=1.0)], False),
        ([jf.RigidBody(jf.Box((0.2, 0.2, 0.2001)), mass=1.0)], False),
    ],
)
def test_it_is_known_when_the_scene_is_built(bodies, isotropic):
    model, _, _ = jf.build(jf.Scene(bodies))
    assert model.rigid.isotropic == isotropic


def test_steps_and_slopes_are_those_of_the_integrator():
    model, params, state = sliding(CUBE)
    assert model.rigid.isotropic
    general = model.replace(rigid=model.rigid.replace(isotropic=False))

    def end(spin, scene):
        rigid = state.rigid.replace(angular_velocities=spin)
        states, info = jf.rollout(scene, params, state.replace(rigid=rigid), 1e-2, 5)
        last = states.rigid
        return jnp.concatenate([last.positions[-1, 0], last.angular_velocities[-1, 0]]), info.status

    spin, change = state.rigid.angular_velocities, jnp.array([[0.3, -0.2, 0.5]])
    found = []
    for scene in (model, general):
        run = jax.jit(lambda u, scene=scene: jax.jvp(lambda v: end(v, scene), (u,), (change,)))
        (value, status), (slope, _) = run(spin)
        assert not np.asarray(status).any()
        found.append((value, slope))
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-6, atol=1e-7)
