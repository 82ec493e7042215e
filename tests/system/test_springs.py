"""Joints that give by a compliance of their own: springs, in steps far longer than their period."""

import jax
import jax.numpy as jnp
import pytest

import jaxfem as jf

G = 9.81


def hanging(stiffness):
    """Three balls of 1 kg, each on a spring [N/m] from the one above."""
    balls = [jf.RigidBody(jf.Sphere(0.05), mass=1.0, position=(0, 0, -0.2 * k), name=f"ball {k}") for k in (1, 2, 3)]
    joints = [
        jf.BallJoint(ball, above, anchor=(0, 0, -0.2 * k), compliance=1 / stiffness)
        for k, (ball, above) in enumerate(zip(balls, (None, *balls), strict=False))
    ]
    return jf.build(jf.Scene(balls, joints=joints), solver="direct")


@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8])
def test_they_are_as_stiff_as_declared(stiffness):
    """All three hang lower by 6 m g / k. The trace that keeps rows apart gave up to 15 % beside it, and goes unsaid."""
    model, params, state = hanging(stiffness)
    states, info = jf.rollout(model, params, state, 1.0, 60)
    assert not info.status.any()
    lower = -0.6 - float(states.rigid.positions[-1, -1, 2])
    assert lower == pytest.approx(6 * G / stiffness, rel=1e-3)


def test_a_rigid_joint_has_the_derivative_of_one_that_gives():
    """From no compliance on, its derivative is that of the sag."""
    model, params, state = hanging(1e9)

    def lowest(compliance):
        joints = {
            name: group.replace(compliance=jnp.full_like(group.compliance, compliance))
            for name, group in params.joints.items()
        }
        return jf.step(model, params.replace(joints=joints), state, 1e-2)[0].rigid.positions[-1, 2]

    slope, change = jax.grad(lowest)(0.0), 1e-8
    assert float(slope) == pytest.approx(float(lowest(change) - lowest(0.0)) / change, rel=1e-2)
    assert slope < 0
