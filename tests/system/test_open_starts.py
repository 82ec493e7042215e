"""Joints that do not hold where their bodies start are named by `build`; angles at and beyond half a turn."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.building.opened import warn_of_open


def joints(body, other):
    """Four that are open, and as many that are not."""
    ends = (0, 0, 0), (0, 0, 1.0)
    return [
        jf.DistanceJoint(body, None, *ends, length=0.3, name="short"),
        jf.DistanceJoint(body, None, *ends, length=0.8, rope=True, name="taut"),
        jf.HingeJoint(None, body, (0, 0, 0), (0, 1, 0), low=0.5, high=1.0, name="bent"),
        jf.SliderJoint(None, other, (5, 0, 0), (0, 0, 1), high=-0.25, name="drawn"),
        jf.DistanceJoint(body, None, *ends, length=0.3, compliance=1e-3, name="spring"),
        jf.DistanceJoint(body, None, *ends, length=1.2, rope=True, name="slack"),
        jf.HingeJoint(None, body, (0, 0, 0), (0, 1, 0), low=-0.5, high=0.0, name="stopped"),
        jf.DistanceJoint(body, other, (0, 0, 0), (5, 0, 0), length=5.0001, name="rounded"),
    ]


def test_joints_that_are_open_at_the_start_are_told_with_how_far():
    box = jf.RigidBody(jf.Box((0.5, 0.1, 0.1)), mass=1.0, name="box")
    other = jf.RigidBody(jf.Box((0.5, 0.1, 0.1)), mass=1.0, position=(5, 0, 0), name="other")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_open(joints(box, other))
    words = [str(each.message) for each in caught if issubclass(each.category, jf.AccuracyWarning)]
    told = {word.split('"')[1]: word.split("open by ")[1].split(" at the")[0] for word in words}
    assert told == {"short": "0.7 m", "taut": "0.2 m", "bent": "0.5 rad", "drawn": "0.25 m"}
    with pytest.warns(jf.AccuracyWarning, match='joint "short" is open by 0.7 m') as caught:
        jf.build(jf.Scene([box], joints=joints(box, other)[:1]))
    assert [each.filename for each in caught] == [__file__]


@pytest.mark.parametrize("closed", [jf.BallJoint(None, "a", (1, 2, 3)), jf.WeldJoint(None, "a", (1, 2, 3))])
def test_joints_of_one_anchor_are_closed_at_the_start(closed):
    assert closed.open_by()[0] == 0


@pytest.mark.slow
def test_angles_have_no_seam_at_half_a_turn():
    """Motors went round for ever past a target beyond pi, and shook about one at pi; an angle of 3.3 beyond a limit
    of 3 was one of -3, beyond the other limit, and was thrown there within a step."""
    rods = [jf.RigidBody(jf.Box((0.5, 0.05, 0.05)), mass=1.0, position=(0.25, k, 0)) for k in range(3)]
    soft = {"position": True, "compliance": 0.1, "damping": 2.0}
    options = [
        {"motor": jf.Motor(4.0, 5.0, **soft)},
        {"motor": jf.Motor(np.pi, 1e3, position=True)},
        {"low": -0.4, "high": 3.0},
    ]
    joints = [jf.HingeJoint(None, each, (0, k, 0), (0, 0, 1), **options[k]) for k, each in enumerate(rods)]
    model, params, state = jf.build(jf.Scene(rods, (0, 0, 0), joints=joints))
    start = np.array([0.0, 0.9 * np.pi, 3.3])
    arms = 0.25 * np.stack([np.cos(start), np.sin(start), 0 * start], -1)
    turned = np.stack([np.cos(start / 2), 0 * start, 0 * start, np.sin(start / 2)], -1)
    places = jnp.asarray(arms + np.arange(3)[:, None] * [0, 1, 0])
    state = state.replace(rigid=state.rigid.replace(positions=places, orientations=jnp.asarray(turned)))
    states, info = jf.rollout(model, params, state, 1 / 60, 240)
    assert not info.status[2:].any()  # a rigid motor may open its joint by turning a tenth of a turn in its first step
    arm = np.asarray(states.rigid.positions) - np.arange(3)[:, None] * [0, 1, 0]
    angle = np.arctan2(arm[..., 1], arm[..., 0])
    np.testing.assert_allclose(angle[-1, 0], 4.0 - 2 * np.pi, atol=1e-3)
    assert angle[:, 0].max() < 0.1  # the short way
    np.testing.assert_allclose(np.abs(angle[-1, 1]), np.pi, atol=1e-6)
    np.testing.assert_allclose(angle[0, 2], 3.0, atol=0.02)  # and not at -0.4
    assert np.abs(states.rigid.angular_velocities[:, 2]).max() < 1.01 * 0.3 * 60
