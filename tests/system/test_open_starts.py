"""Joints that do not hold where their bodies start are named by `build`: closing them throws what they hold."""

import warnings

import pytest

import jaxfem as jf


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
        jf.build(jf.Scene([box, other], joints=joints(box, other)))
    words = [str(each.message) for each in caught if issubclass(each.category, jf.AccuracyWarning)]
    told = {word.split('"')[1]: word.split("open by ")[1].split(" at the")[0] for word in words}
    assert told == {"short": "0.7 m", "taut": "0.2 m", "bent": "0.5 rad", "drawn": "0.25 m"}
    assert all(each.filename == __file__ for each in caught)


@pytest.mark.parametrize("closed", [jf.BallJoint(None, "a", (1, 2, 3)), jf.WeldJoint(None, "a", (1, 2, 3))])
def test_joints_of_one_anchor_are_closed_at_the_start(closed):
    assert closed.open_by()[0] == 0
