"""Bodies that start inside each other, and boxes of one size on top of each other."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

SIDE = 0.4


@pytest.fixture(scope="module")
def sunken():
    """A box half a metre below the ground."""
    box = jf.RigidBody(jf.Box((SIDE,) * 3), mass=10.0, position=(0, 0, -0.5 + SIDE / 2), name="sunken")
    with pytest.warns(jf.OverlapWarning, match=r'"sunken" and the Plane start inside each other, 0.5 m deep'):
        return jf.build(jf.Scene([box], contacts=[jf.Contact(box, jf.Plane(), friction=0.0, name="floor")]))


@pytest.mark.parametrize("speed", [0.4, 2.0])
def test_a_box_below_the_ground_rises_at_the_contact_s_speed_and_stays_there(sunken, speed):
    model, params, state = sunken
    (name,) = params.contacts
    np.testing.assert_allclose(params.contacts[name].separation, SIDE)  # its size in a second
    contacts = {name: params.contacts[name].replace(separation=jnp.full(8, speed))}
    states, info = jf.rollout(model, params.replace(contacts=contacts), state, 1 / 60, 150)
    assert not info.status.any()
    up = states.rigid.velocities[:, 0, 2]
    assert float(up.max()) == pytest.approx(speed, rel=1e-6)
    top = states.rigid.positions[:, 0, 2] - SIDE / 2
    assert float(top.max()) < 1e-3  # none of the speed is left to throw it up
    assert float(top[-1]) == pytest.approx(0, abs=1e-3)
    kinetic = 0.5 * up**2
    assert float(kinetic[-1]) < 1e-6 * speed**2


def test_two_bodies_are_named_with_their_depth_and_side_by_side_nothing_is_said(recwarn):
    below = jf.RigidBody(jf.Box((0.2,) * 3), mass=1.0, name="below")
    soft = jf.SoftBody(jf.mesh.box((0.1,) * 3, 1, origin=(0, 0, 0.07)), 1e5, 0.3, 1e3, name="soft")
    with pytest.warns(jf.OverlapWarning, match=r'contact 0: "soft" and "below" start inside each other, 0.03 m deep'):
        jf.build(jf.Scene([below, soft], contacts=[jf.Contact(soft, below)]))
    recwarn.clear()
    above = jf.SoftBody(jf.mesh.box((0.1,) * 3, 1, origin=(0, 0, 0.1)), 1e5, 0.3, 1e3, name="soft")
    jf.build(jf.Scene([below, above], contacts=[jf.Contact(above, below)]))
    assert not [each for each in recwarn if issubclass(each.category, jf.OverlapWarning)]


@pytest.mark.parametrize("friction", [0.0, pytest.param(1e-6, marks=pytest.mark.slow)])
def test_boxes_of_one_size_do_not_drift_off_each_other(friction):
    """Corners on edges: rounding chose a side face's normal, and frictionless boxes slid off in ten seconds."""
    boxes = [jf.RigidBody(jf.Box((0.2,) * 3), mass=1.0, position=(0, 0, 0.1 + 0.2 * k)) for k in range(2)]
    contacts = [jf.Contact(boxes[0], jf.Plane(), friction=friction), jf.Contact(boxes[1], boxes[0], friction=friction)]
    built = jf.build(jf.Scene(boxes, contacts=contacts), dtype=jnp.float32)
    states, info = jf.rollout(*built, 1 / 60, 300, every=60)
    assert not info.status.any()
    places = np.asarray(states.rigid.positions)
    assert np.abs(places[:, :, :2]).max() < 1e-4
    np.testing.assert_allclose(places[-1, :, 2], [0.1, 0.3], atol=1e-5)


BLOCK, PLANK, CAN = jf.Box((0.2,) * 3), jf.Box((0.6, 0.1, 0.05)), jf.Cylinder(0.1, 0.2)
ACROSS = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))
INSIDE = [  # shape, its height at rest, place of the second one, its turn, how far apart they end, along which axis
    pytest.param(BLOCK, 0.1, (0, 0, 0.2), None, 0.2, 2, id="above"),
    pytest.param(BLOCK, 0.1, (0.1, 0, 0.1), None, 0.2, 0, marks=pytest.mark.slow, id="beside"),
    pytest.param(BLOCK, 0.1, (0, 0, 0.1), None, 0.2, 2, id="in one place"),
    pytest.param(PLANK, 0.025, (0, 0, 0.05), ACROSS, 0.05, 2, marks=pytest.mark.slow, id="planks across"),
    pytest.param(CAN, 0.1, (0, 0, 0.2), None, 0.2, 2, marks=pytest.mark.slow, id="cylinders"),
]


@pytest.mark.filterwarnings("ignore::jaxfem.OverlapWarning")
@pytest.mark.parametrize(("shape", "height", "place", "turn", "apart", "axis"), INSIDE)
def test_two_bodies_inside_each_other_part_at_the_contact_s_speed(shape, height, place, turn, apart, axis):
    one = jf.RigidBody(shape, mass=1.0, position=(0, 0, height), name="one")
    other = jf.RigidBody(shape, mass=1.0, position=place, orientation=turn or (1, 0, 0, 0), name="other")
    contacts = [jf.Contact(one, other), *(jf.Contact(each, jf.Plane()) for each in (one, other))]
    scene = jf.Scene([one, other], contacts=contacts)
    states, info = jf.rollout(*jf.build(scene, max_iterations=2000), 1 / 60, 100, every=2)
    assert not info.status[:25].any()
    if axis == 2:  # blocks that touch side by side on a floor: some steps reach the limit, and say so
        assert not info.status.any()
    speed = float(np.ptp(shape.extent(), axis=0).max())
    assert float(np.abs(states.rigid.velocities).max()) < 1.01 * speed
    way = np.asarray(states.rigid.positions[-1, 1] - states.rigid.positions[-1, 0])
    assert np.abs(way[axis]) == pytest.approx(apart, abs=2e-3)
    assert float(np.abs(states.rigid.velocities[-1]).max()) < 1e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxfem.OverlapWarning")
def test_boxes_that_part_on_a_floor_come_to_rest_within_few_iterations():
    """Rows at friction's bounds were let go when these moved, and all sides sought anew: an active set that circled."""
    boxes = [jf.RigidBody(jf.Box((0.2,) * 3), mass=1.0, position=(0.1 * k, 0, 0.1)) for k in range(2)]
    contacts = [*(jf.Contact(box, jf.Plane()) for box in boxes), jf.Contact(*boxes)]
    model, params, state = jf.build(jf.Scene(boxes, contacts=contacts), tolerance=1e-8)
    for moved, mass in ((0, 1), (1e-3, 1), (0.137, 1), (1, 1), (0, 1 + 1e-6), (0, 1.1), (0, 2)):
        rigid = state.rigid.replace(positions=state.rigid.positions + jnp.array([moved, 0.7 * moved, 0]))
        heavier = params.replace(rigid=params.rigid.replace(mass=params.rigid.mass * jnp.array([mass, 1])))
        states, info = jf.rollout(model, heavier, state.replace(rigid=rigid), 1 / 60, 100)
        assert not info.status.any()
        assert int(info.iterations.max()) < 1000
        assert float(jnp.abs(states.rigid.velocities[-1]).max()) < 1e-4
        np.testing.assert_allclose(states.rigid.positions[-1, :, 2], 0.1, atol=1e-3)
