"""Rigid bodies alone: free flight and spin, motion that is prescribed, batches, derivatives, messages."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from derivatives import Parted

import jaxfem as jf
from jaxfem.rigid.dynamics import angular_momentum
from jaxfem.rotation import quaternion_to_matrix

SIZE = (0.3, 0.2, 0.1)
NOTHING = (0.0, 0.0, 0.0)


@jax.jit
def spins(model, params, states):
    return jax.vmap(lambda rigid: angular_momentum(model.rigid, params.rigid.mass, rigid))(states.rigid)[:, 0]


def test_a_free_symmetric_body_spins_and_flies_exactly():
    ball = jf.RigidBody(jf.Sphere(0.1), mass=2.0, velocity=(1.0, 0, 3.0), angular_velocity=(0, 0, 2.0))
    model, params, state = jf.build(jf.Scene([ball]))
    states, info = scenes.rolled(model, params, state, 1e-2, 50, 50)
    last = jax.tree.map(lambda leaf: leaf[-1], states.rigid)
    t = 0.5
    np.testing.assert_allclose(last.positions[0], [t, 0, 3 * t - 9.81 * t * (t + 1e-2) / 2], atol=1e-12)
    np.testing.assert_allclose(last.orientations[0], [np.cos(t), 0, 0, np.sin(t)], atol=1e-12)
    np.testing.assert_allclose(last.angular_velocities[0], [0, 0, 2.0], atol=1e-13)
    assert not info.status.any()


def test_the_tennis_racket_turns_over_and_keeps_its_momentum():
    """Spin about the middle axis: the half period of the flip from the elliptic integral, here from a fine solution
    of Euler's equations; |L| and L to rounding, energy to second order."""
    body = jf.RigidBody(jf.Box(SIZE), density=1e3, angular_velocity=(0.01, 10.0, 0.0))
    model, params, state = jf.build(jf.Scene([body], gravity=NOTHING))
    states, _ = scenes.rolled(model, params, state, 1e-3, 2500, 50)
    momentum = spins(model, params, states)
    start = angular_momentum(model.rigid, params.rigid.mass, state.rigid)
    assert jnp.abs(momentum - start).max() < 1e-12 * jnp.linalg.norm(start)
    energy = jax.vmap(lambda s: jf.energies(model, params, s).kinetic)(states)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-5)
    turn = quaternion_to_matrix(states.rigid.orientations[:, 0])
    own = jnp.einsum("tji,tj->ti", turn, states.rigid.angular_velocities[:, 0])[:, 1]
    flip = int(jnp.argmax(own < 0)) * 1e-3
    assert abs(flip - euler_flip(np.diag(body.properties[2]), [0.01, 10.0, 0.0])) < 3e-3


def euler_flip(inertia, spin):
    """When the middle component first changes sign: classical Runge-Kutta on I w' = I w x w, steps of 10 us."""

    def rate(w):
        return np.cross(inertia * w, w) / inertia

    w, dt, t = np.array(spin, float), 1e-4, 0.0
    while w[1] > 0:
        a = rate(w)
        b = rate(w + dt / 2 * a)
        c = rate(w + dt / 2 * b)
        w, t = w + dt / 6 * (a + 2 * b + 2 * c + rate(w + dt * c)), t + dt
    return t


def test_a_huge_spin_stays_bounded():
    body = jf.RigidBody(jf.Box(SIZE), density=1e3, angular_velocity=(300.0, 900.0, 200.0))
    model, params, state = jf.build(jf.Scene([body], gravity=NOTHING))
    states, _ = scenes.rolled(model, params, state, 1 / 60, 400, 50)
    momentum = jnp.linalg.norm(spins(model, params, states), axis=1)
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-10)


def test_fixed_and_driven_bodies():
    motion = jf.Motion(velocity=(0.1, 0, 0), angular_velocity=(0, 0, 3.0), center=(0, 0, 0))
    still = jf.RigidBody(jf.Sphere(0.1), mass=1.0, fixed=True, velocity=(1, 1, 1), name="still")
    moved = jf.RigidBody(jf.Box(SIZE), mass=1.0, position=(1.0, 0, 0), motion=motion, name="moved")
    model, params, state = jf.build(jf.Scene([still, moved]))
    states, _ = jf.rollout(model, params, state, 1e-2, 100)
    last = jax.tree.map(lambda leaf: leaf[-1], states.rigid)
    np.testing.assert_allclose(last.positions[0], 0, atol=0)
    np.testing.assert_allclose(last.positions[1], [np.cos(3) + 0.1, np.sin(3), 0], atol=1e-12)
    np.testing.assert_allclose(quaternion_to_matrix(last.orientations[1])[:2, 0], [np.cos(3), np.sin(3)], atol=1e-12)
    np.testing.assert_allclose(last.angular_velocities[1], [0, 0, 3.0], atol=1e-9)


def test_single_precision_and_lanes():
    body = jf.RigidBody(jf.Box(SIZE), density=1e3, angular_velocity=(1.0, 10.0, 0.5))
    model, params, state = jf.build(jf.Scene([body]), dtype=jnp.float32)
    spins_of = jnp.linspace(0.5, 2.0, 3, dtype=jnp.float32)

    def run(scale):
        start = state.rigid.replace(angular_velocities=scale * state.rigid.angular_velocities)
        states, _ = jf.rollout(model, params, state.replace(rigid=start), 1e-2, 20)
        return states.rigid.orientations[-1]

    lanes = jax.vmap(run)(spins_of)
    assert lanes.dtype == jnp.float32
    np.testing.assert_allclose(lanes, jnp.stack([run(each) for each in spins_of]), atol=1e-6)


def test_derivatives_of_a_tumble():
    body = jf.RigidBody(jf.Box(SIZE), density=1e3, angular_velocity=(1.0, 5.0, 0.5))
    model, params, state = jf.build(jf.Scene([body]))
    weights = jnp.asarray(np.random.default_rng(0).standard_normal((1, 4)))

    @Parted
    def loss(spin):
        start = state.rigid.replace(angular_velocities=spin)
        states, _ = jf.rollout(model, params, state.replace(rigid=start), 1e-2, 30)
        return jnp.sum(weights * states.rigid.orientations[-1])

    spin = state.rigid.angular_velocities
    direction = jnp.asarray([[0.3, -0.2, 0.5]])
    forward, (gradient,) = loss.forwards(spin, direction=(direction,)), loss.backwards(spin)
    value = jnp.sum(gradient * direction)
    np.testing.assert_allclose(forward, value, rtol=1e-12)
    h = 1e-5
    ahead, behind = (loss(spin + s * h * direction) for s in (1, -1))
    np.testing.assert_allclose((ahead - behind) / (2 * h), value, rtol=1e-8, atol=1e-10)  # rounding: 2e-16 / h


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"shape": 3}, "is one of Sphere, Box"),
        ({"shape": jf.Sphere(-1.0), "mass": 1}, "lengths must be positive"),
        ({"shape": jf.Sphere(1.0)}, "`density` in kg/m\\^3 or `mass`"),
        ({"shape": jf.Sphere(1.0), "mass": 0}, "more than 0"),
        ({"shape": jf.Sphere(1.0), "mass": 1, "position": (1, 2)}, "three finite numbers"),
        ({"shape": jf.Sphere(1.0), "mass": 1, "orientation": (0, 0, 0, 0)}, "all zeros"),
        ({"shape": jf.Sphere(1.0), "mass": 1, "inertia": -np.eye(3)}, "positive definite"),
        ({"shape": jf.Sphere(1.0), "mass": 1, "fixed": True, "motion": jf.Motion()}, "not `fixed` as well"),
    ],
)
def test_impossible_bodies_are_refused(arguments, text):
    with pytest.raises(jf.SceneError, match=text):
        jf.RigidBody(**arguments)


def test_what_does_not_go_together_is_refused():
    scene = jf.Scene([jf.RigidBody(jf.Sphere(0.1), mass=1.0)])
    with pytest.raises(jf.SceneError, match="scenes with rigid bodies need"):
        jf.build(scene, scheme="generalized_alpha")
    soft = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), young=1e5, poisson=0.3, density=1e3)
    with pytest.raises(jf.SceneError, match="with rigid bodies, joints or contacts"):
        jf.build(jf.Scene([soft]), solver="pgs")


def test_wrong_params_are_refused():
    model, params, state = jf.build(jf.Scene([jf.RigidBody(jf.Sphere(0.1), mass=1.0)]))
    with pytest.raises(jf.StepError, match=r"rigid.mass has shape .*; give an array of shape \(1,\)"):
        jf.step(model, params.replace(rigid=params.rigid.replace(mass=jnp.ones(3))), state, 1e-2)
    with pytest.raises(jf.StepError, match="comes to rest by steps"):
        jf.equilibrium(model, params, state)
    with pytest.raises(jf.StepError, match="modes takes soft bodies alone"):
        jf.modes(model, params, state, count=1)
    with pytest.raises(jf.StepError, match="belong together"):
        jf.step(model, params.replace(rigid=None), state, 1e-2)
