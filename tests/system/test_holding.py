"""Joints that cannot all hold, and joints that a step leaves open, have a status that names them; others have none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.solvers import Status, describe

DT = 1 / 60


def cube(x=0.0, name="cube"):
    return jf.RigidBody(jf.Box((0.1, 0.1, 0.1)), mass=1.0, position=(x, 0, 0), name=name)


def block():
    return jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), (1, 1, 1)), young=1e5, poisson=0.3, density=1e3, name="cube")


def balls(apart):
    """Two points of the world, as far apart as told, to which one point of a body is tied."""
    return [jf.BallJoint(None, "cube", (x, 0, 0), (0, 0, 0), name=n) for x, n in ((0.0, "here"), (apart, "there"))]


def rods(longer):
    """Two lengths for one distance."""
    ends = (0, 0, 0.3), (0, 0, 0)
    return [jf.DistanceJoint(None, "cube", *ends, length=r, name=n) for r, n in ((0.3, "here"), (longer, "there"))]


@pytest.mark.parametrize("joints", [balls(0.5), rods(0.6)], ids=["balls", "rods"])
@pytest.mark.parametrize("body", [cube, pytest.param(block, marks=pytest.mark.slow)])
def test_joints_that_cannot_both_hold_are_named(body, joints):
    model, params, state = jf.build(jf.Scene([body()], joints=joints))
    states, infos = scenes.rolled(model, params, state, DT, 10)
    assert {Status(int(each)) for each in infos.status} == {Status.CONTRADICTORY_JOINTS}
    assert describe(infos.status[0]).startswith("contradictory joints: here, there")
    found = jf.diagnose(model, params, states, infos)
    assert found.step == 1 and found.status is Status.CONTRADICTORY_JOINTS
    assert {each.name for each in found.findings if each.kind == "open"} == {"here", "there"}
    assert "contradictory joints: here, there" in str(found)


def test_what_makes_them_agree_makes_them_converge():
    """In params: the same program, with lengths that agree, and with one of them soft."""
    model, params, state = jf.build(jf.Scene([cube()], joints=rods(0.6)))
    (label,) = params.joints
    lengths = params.joints[label]
    agreed = params.replace(joints={label: lengths.replace(length=jnp.array([0.3, 0.3]))})
    assert not scenes.rolled(model, agreed, state, DT, 10)[1].status.any()
    soft = params.replace(joints={label: lengths.replace(compliance=jnp.array([0.0, 1e-3]))})
    assert not scenes.rolled(model, soft, state, DT, 10)[1].status.any()


@pytest.mark.parametrize("dtype", [jnp.float64, pytest.param(jnp.float32, marks=pytest.mark.slow)])
def test_redundant_joints_that_agree_are_fine(dtype):
    """Two welds of one body, and two hinges of another on one axis: eleven rows for five."""
    bodies = [cube(0, "post"), cube(0.1, "door")]
    joints = [
        jf.WeldJoint(None, "post", (0, 0, 0), name="weld"),
        jf.WeldJoint(None, "post", (0.05, 0, 0), name="again"),
        jf.HingeJoint("post", "door", (0.05, 0.05, 0), (0, 1, 0), name="upper"),
        jf.HingeJoint("post", "door", (0.05, -0.05, 0), (0, 1, 0), name="lower"),
    ]
    model, params, state = jf.build(jf.Scene(bodies, joints=joints), dtype=dtype)
    states, infos = scenes.rolled(model, params, state, DT, 60)
    assert not infos.status.any()
    assert states.rigid.positions[:, 1, 2].min() < -0.04  # it swings


@pytest.fixture(scope="module")
def driven():
    """A motor on a link of 1 g, a ball joint, and another link."""
    size = jf.Box((0.1, 0.02, 0.02))
    links = [jf.RigidBody(size, mass=1e-3, position=(0.05 + 0.1 * i, 0, 0), name=f"link {i}") for i in range(2)]
    drive = jf.HingeJoint(None, links[0], (0, 0, 0), (0, 1, 0), motor=jf.Motor(1.0, 1.0), name="drive")
    return jf.build(jf.Scene(links, joints=[drive, jf.BallJoint(*links, (0.1, 0, 0), name="elbow")]))


def turned(driven, mass, target, strength):
    """A run with another mass of the second link and another motor."""
    model, params, state = driven
    (label,) = [each for each in params.joints if "motor" in each]
    motor = params.joints[label].replace(target=jnp.array([target]), strength=jnp.array([strength]))
    params = params.replace(
        rigid=params.rigid.replace(mass=jnp.array([1e-3, mass])), joints={**params.joints, label: motor}
    )
    return params, *scenes.rolled(model, params, state, DT, 30)


@pytest.mark.parametrize(("mass", "strength"), [(1e-3, 1e3), (1.0, 1e3), (1e3, 1e6)])
def test_a_strong_motor_holds_its_rate_and_joints_hold(driven, mass, strength):
    _, states, infos = turned(driven, mass, 3.0, strength)
    assert not infos.status.any()
    np.testing.assert_allclose(states.rigid.angular_velocities[:, 0, 1], 3.0, rtol=1e-6)
    tip = states.rigid.positions[:, 0] + 0.05 * rotated(states.rigid.orientations[:, 0])
    elbow = states.rigid.positions[:, 1] - 0.05 * rotated(states.rigid.orientations[:, 1])
    assert np.abs(tip - elbow).max() < 5e-3


def rotated(orientations):
    """The bodies' first axes."""
    w, x, y, z = orientations.T
    return np.stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], -1)


def test_a_joint_that_a_wild_motor_opens_is_named(driven):
    model, *_ = driven
    params, states, infos = turned(driven, 1e-3, 1e4, 1.0)
    bad = [Status(int(each)) for each in infos.status if each]
    assert bad and set(bad) <= {Status.OPEN_JOINTS, Status.CONTRADICTORY_JOINTS}
    assert any(name in describe(infos.status[infos.status != 0][0]) for name in ("elbow", "drive"))
    assert not jf.diagnose(model, params, states, infos).ok


def test_lanes_are_judged_on_their_own():
    model, params, state = jf.build(jf.Scene([cube()], joints=rods(0.6)))
    (label,) = params.joints
    longer = jnp.array([0.3, 0.6, 0.30001])

    def status(length):
        lengths = params.joints[label].replace(length=jnp.stack([jnp.asarray(0.3), length]))
        return jf.step(model, params.replace(joints={label: lengths}), state, DT)[1].status

    assert [int(each) == 0 for each in jax.vmap(status)(longer)] == [True, False, True]
