"""Joints that give by a compliance of their own: springs, in steps far longer than their period."""

import jax
import jax.numpy as jnp
import pytest

import jaxfem as jf
from jaxfem.solvers import describe

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


SPIN, INERTIA = 8.0, 0.04 / 6  # of a cube of 1 kg and .2 m


@pytest.mark.parametrize("kind", [jf.WeldJoint, jf.HingeJoint, jf.SliderJoint])
@pytest.mark.parametrize(("reach", "passes"), [(3.1, False), (3.3, True)])
def test_a_spring_that_is_bent_past_half_a_turn_is_named(kind, reach, passes):
    """Its energy at that angle [rad] is that of the spin: beyond pi it turns its body on, the other way round."""
    box = jf.RigidBody(jf.Box((0.2,) * 3), mass=1.0, angular_velocity=(SPIN, 0, 0), name="box")
    axis = {} if kind is jf.WeldJoint else {"axis": (0, 0, 1), "anchor": (0, 0, 0)}
    joint = kind(box, None, compliance=reach**2 / (INERTIA * SPIN**2), name="bent", **axis)
    model, params, state = jf.build(jf.Scene([box], joints=[joint], gravity=(0, 0, 0)), solver="direct")
    _, info = jf.rollout(model, params, state, 1e-2, 80)
    bad = [describe(int(code)) for code in info.status if int(code)]
    assert len(bad) == passes and all('joint "bent", bent past half a turn' in text for text in bad)
