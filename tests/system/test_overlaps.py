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
