"""Rows eliminated (solver "direct"): the answer and derivatives of MPRGP and Gauss-Seidel, also where singular."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from standard import STANDARD

import jaxfem as jf

DT = 1e-2


@pytest.mark.slow
def test_limits_motors_ropes_and_contacts_end_as_with_the_other_solvers():
    model, direct, info = STANDARD["doll"].run("auto")
    assert model.method.name == "direct" and info.iterations.max() < 30
    angles = jf.impulses(model, direct)["joint angle limit rigid-rigid"]
    assert (jnp.abs(angles).max((0, 2)) > 0).all()  # both limits were reached
    for solver in ("mprgp", "pgs"):
        _, other, _ = STANDARD["doll"].run(solver)
        np.testing.assert_allclose(direct.rigid.positions, other.rigid.positions, atol=1e-7, err_msg=solver)


@pytest.mark.slow
def test_derivatives_through_a_limit_and_every_lane_of_a_batch():
    upper = jf.RigidBody(jf.Box((0.4, 0.1, 0.1)), mass=1.0, position=(0.2, 0, 0), angular_velocity=(0, 2.0, 0))
    lower = jf.RigidBody(jf.Box((0.4, 0.1, 0.1)), mass=0.5, position=(0.6, 0, 0))
    knee = jf.HingeJoint(upper, lower, (0.4, 0, 0), (0, 1, 0), low=-0.05, high=0.05)
    scene = jf.Scene([upper, lower], joints=[knee, jf.BallJoint(None, upper, (0, 0, 0))])
    model, params, state = jf.build(scene, tolerance=1e-12)

    def end(mass, speed):
        start = state.rigid.replace(angular_velocities=speed * state.rigid.angular_velocities)
        values = params.replace(rigid=params.rigid.replace(mass=params.rigid.mass.at[1].multiply(mass)))
        states, _ = jf.rollout(model, values, state.replace(rigid=start), DT, 4)
        limits = jf.impulses(model, states)["joint angle limit rigid-rigid"]
        return states.rigid.positions[-1, 1, 2] + states.rigid.velocities[-1, 1, 0], jnp.abs(limits).max()

    run = derivatives.check(end, (1.0, 1.0), has_aux=True)
    assert run(1.0, 1.0)[1] > 0
    factors = jnp.array([1.0, 4.0])
    batch = jax.vmap(end)(factors, factors)[0]
    np.testing.assert_allclose(batch, [run(f, f)[0] for f in factors], rtol=1e-9)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_four_equal_joints_share_the_load_and_its_derivative(dtype):
    body = jf.RigidBody(jf.Sphere(0.1), mass=2.0, position=(0, 0, -0.5))
    scene = jf.Scene([body], joints=[jf.BallJoint(body, None, (0, 0, 0)) for _ in range(4)])
    model, params, state = jf.build(scene, dtype=dtype)
    assert model.method.name == "direct"

    def load(mass):
        values = params.replace(rigid=params.rigid.replace(mass=mass * params.rigid.mass))
        following, info = jf.step(model, values, state, DT)
        (impulses,) = jf.impulses(model, following).values()
        return impulses[:, 2], info.status

    (found, status), (slope, _) = jax.jvp(load, (jnp.ones((), dtype),), (jnp.ones((), dtype),))
    assert status == 0
    exact = -2.0 * 9.81 * DT / 4  # on the joints' second end, the world
    np.testing.assert_allclose(jnp.abs(found.sum()), 4 * abs(exact), rtol=1e-4)
    np.testing.assert_allclose(jnp.abs(slope.sum()), 4 * abs(exact), rtol=1e-3)
    if dtype == jnp.float64:  # in single precision only the sum is determined: shares differ by rounding over the trace
        np.testing.assert_allclose(jnp.abs(found), abs(exact), rtol=1e-4)
        np.testing.assert_allclose(jnp.abs(slope), abs(exact), rtol=1e-3)


def test_what_cannot_be_eliminated_is_refused_by_name():
    soft = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), young=1e5, poisson=0.3, density=1e3)
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0)
    with pytest.raises(jf.SceneError, match='"direct" is for scenes with rigid'):
        jf.build(jf.Scene([soft]), solver="direct")
    with pytest.raises(jf.SceneError, match="soft bodies"):
        jf.build(jf.Scene([soft, ball], joints=[jf.BallJoint(soft, ball, (0.5, 0.5, 0.5))]), solver="direct")


def test_the_method_that_was_asked_for_is_taken_or_refused_by_name_and_the_model_says_why():
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 1.0))
    cube = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), young=1e5, poisson=0.3, density=1e3)
    for bodies, words in (
        ([ball], "works on the nodes of soft bodies"),
        ([ball, cube], "takes rigid bodies that joints"),
    ):
        with pytest.raises(jf.SceneError, match=f'solver "condensed" {words}.* use "auto"'):
            jf.build(jf.Scene(bodies), solver="condensed")
    model = jf.build(jf.Scene([ball]))[0]
    assert model.choice.asked == "auto" and model.choice.reason and model.method.name in ("direct", "mprgp")
