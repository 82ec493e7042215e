"""Free turning keeps angular momentum and energy at any spin, is exact where a spin is steady, of second order else."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.rigid.dynamics import angular_momentum
from jaxfem.rigid.turning import mean_spin
from jaxfem.rotation import quaternion_to_matrix, rotation_vector_to_matrix

SIZE = (0.1, 0.2, 0.3)
INERTIA = jnp.diag(jnp.array([0.13, 0.10, 0.05]) / 12)
SPINS = [(0.1, 100, 0), (0.1, 30, 0), (3, 300, 1), (1, 2, 3), (1e3, 2e3, 1), (400, 2, 500)]  # rad/s, in the body


@jax.jit
def turned(rotation, spin, dt):
    """Rotation and angular velocity after a step, by momentum that is kept."""
    momentum = rotation @ INERTIA @ rotation.T @ spin
    end = rotation_vector_to_matrix(dt * mean_spin(INERTIA[None], rotation[None], spin[None], dt)[0]) @ rotation
    return end, end @ jnp.linalg.solve(INERTIA, end.T @ momentum)


@jax.jit
def turned_often(rotation, spin, dt):
    """After 10 steps."""
    return jax.lax.fori_loop(0, 10, lambda _, carry: turned(*carry, dt), (rotation, spin))


@pytest.mark.parametrize(("dtype", "energy", "momentum"), [(jnp.float64, 1e-10, 1e-12), (jnp.float32, 5e-3, 3e-4)])
def test_ten_thousand_steps_of_tumbling_keep_energy_and_momentum(dtype, energy, momentum):
    """At 1/60 s, up to 33 rad a step; what is left is the rounding of states, which walks."""
    bodies = [jf.RigidBody(jf.Box(SIZE), mass=2.0, orientation=(0.9, 0.1 * i, 0.2, -0.3)) for i in range(len(SPINS))]
    model, params, state = jf.build(jf.Scene(bodies, gravity=(0, 0, 0)), dtype=dtype)
    turn = quaternion_to_matrix(state.rigid.orientations)
    spins = jnp.einsum("bij,bj->bi", turn, jnp.asarray(SPINS, dtype))
    state = state.replace(rigid=state.rigid.replace(angular_velocities=spins))
    states, infos = jf.rollout(model, params, state, 1 / 60, 10_000, every=100)
    assert not infos.status.any()

    def found(rigid):
        spin = angular_momentum(model.rigid, params.rigid.mass, rigid)
        return spin, jnp.sum(spin * rigid.angular_velocities, -1)

    (first, start), (spin, held) = jax.tree.map(np.asarray, (found(state.rigid), jax.vmap(found)(states.rigid)))
    np.testing.assert_allclose(held / start, 1, rtol=energy)
    size = np.linalg.norm(first, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(spin - first, axis=-1) / size, 0, atol=momentum)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [0.1, 2.0, 20.0])
def test_a_spin_about_a_principal_axis_is_exact(axis, angle):
    rotation = jnp.asarray(scenes.random_rotation(1))
    spin = angle * rotation[:, axis]
    np.testing.assert_allclose(mean_spin(INERTIA[None], rotation[None], spin[None], jnp.ones(()))[0], spin, rtol=1e-13)


def test_equal_inertias_are_no_trouble():
    shapes = [jf.Sphere(0.1), jf.Box((0.1, 0.1, 0.1)), jf.Cylinder(0.1, 0.4)]
    spin = (3.0, 40.0, -20.0)
    bodies = [
        jf.RigidBody(shape, mass=1.0, position=(i, 0, 0), angular_velocity=spin) for i, shape in enumerate(shapes)
    ]
    model, params, state = jf.build(jf.Scene(bodies, gravity=(0, 0, 0)))
    states, _ = jf.rollout(model, params, state, 1 / 60, 100)
    energy = jax.vmap(lambda one: jf.energies(model, params, one).kinetic)(states)
    np.testing.assert_allclose(energy, jf.energies(model, params, state).kinetic, rtol=1e-12)
    np.testing.assert_allclose(states.rigid.angular_velocities[-1, :2], [spin, spin], rtol=1e-11)


def test_it_is_of_second_order():
    """Against steps 64 times finer."""
    start = jnp.eye(3), jnp.array([1.0, 6.0, -2.0])

    def end(parts):
        now = start
        for _ in range(parts):
            now = turned_often(*now, 0.05 / parts)
        return now[0]

    exact = end(64)
    errors = [float(jnp.abs(end(parts) - exact).max()) for parts in (1, 2, 4)]
    assert errors[0] < 0.05
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 4, rtol=0.2)


def test_backwards_leads_back():
    rotation, spin = jnp.eye(3), jnp.array([1.0, 6.0, -2.0])
    back = turned_often(*turned_often(rotation, spin, 0.05), -0.05)
    np.testing.assert_allclose(back[0], rotation, atol=1e-12)
    np.testing.assert_allclose(back[1], spin, atol=1e-12)


@pytest.mark.parametrize("angle", [0.3, 3.0])  # Newton's method serves the first, the second is put on its energy
def test_derivatives_are_those_of_the_rule(angle):
    rotation, weights = jnp.asarray(scenes.random_rotation(2))[None], jnp.array([0.3, -0.5, 0.8])

    def loss(along, across, dt, stretch):
        spin = angle * jnp.stack([along, across, -along + 0.2 * across])[None]
        inertia = INERTIA.at[0, 0].multiply(stretch)[None]
        return jnp.sum(weights * mean_spin(inertia, rotation, spin, dt)[0])

    derivatives.check(loss, (1.0, 0.7, 1.0, 1.2))


def test_derivatives_of_derivatives_and_of_what_does_not_turn():
    def first(spin):
        return mean_spin(INERTIA[None], jnp.eye(3)[None], spin[None], jnp.asarray(0.1))[0, 0]

    gradients = jax.jit(lambda spin: (jax.grad(first)(spin), jax.jvp(jax.grad(first), (spin,), (jnp.ones(3),))[1]))
    at_rest, second = gradients(jnp.zeros(3))
    np.testing.assert_allclose(at_rest, [1, 0, 0], atol=1e-12)
    assert jnp.isfinite(second).all()
    tumbling = jnp.array([1.0, 2.0, 3.0])
    ahead, behind = (gradients(tumbling + h)[0] for h in (1e-5, -1e-5))
    np.testing.assert_allclose((ahead - behind) / 2e-5, gradients(tumbling)[1], atol=1e-8)
