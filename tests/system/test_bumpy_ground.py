"""Ground over a grid: balls at ridges and in valleys, boxes on ridges, and nothing more where it is even."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

RIDGE = np.array([[-1.0], [0.0], [-1.0]]) * np.ones((1, 3))  # a roof along y, 45 degrees, at x = 0


def ground(heights, spacing=(1.0, 1.0)):
    return jf.HeightField(
        heights, spacing, tuple(-s * (n - 1) / 2 for s, n in zip(spacing, heights.shape, strict=True))
    )


@pytest.mark.parametrize("radius", [0.3, 1.2])
def test_balls_see_the_nearest_point_of_a_roof_and_of_a_valley(radius):
    """Also where they are larger than its cells; a roof goes on level beyond its edge."""
    roof = ground(RIDGE, (2.0, 2.0)).measured(radius)
    half = np.sqrt(0.5)
    assert float(roof.distance(jnp.array([0.0, 0.1, radius]))) == pytest.approx(radius, abs=1e-12)
    slope = np.array([1.0, 0, 2.0]) / np.sqrt(5)
    on_face = np.array([1.0, 0.0, -0.5]) + radius * slope
    np.testing.assert_allclose(roof.distance(jnp.asarray(on_face)), radius, atol=1e-9)
    np.testing.assert_allclose(jax.grad(roof.distance)(jnp.asarray(on_face)), slope, atol=1e-9)
    steep = ground(np.array([[2.0], [0.0], [1.0]]) * np.ones((1, 3)), (2.0, 2.0))  # the right half as steep
    valley = steep.measured(radius)
    place = np.array([0.05, 0.0, 1.0])  # over the right side, nearer to the left one
    expected = min(abs(place @ np.array([half, 0, half])), abs(place @ np.array([-1, 0, 2]) / np.sqrt(5)))
    np.testing.assert_allclose(valley.distance(jnp.asarray(place)), expected, atol=1e-9)


def test_even_ground_has_nothing_more():
    slope = ground(np.add.outer(np.arange(4) * 0.5, np.zeros(3)))
    box = jf.RigidBody(jf.Box((0.2, 0.2, 0.2)), mass=1.0)
    ball = jf.RigidBody(jf.Sphere(0.2), mass=1.0)
    even = ground(np.zeros((3, 3)))
    assert even.measured(0.2) is even
    scene = jf.Scene([box, ball], contacts=[jf.Contact(box, even, name="b"), jf.Contact(ball, even, name="s")])
    found = jf.build(scene, solver="mprgp")[0].contacts
    kinds = {label.split(" ", 1)[1] for label in found}
    assert kinds == {"rigid-ground heightfield b", "rigid-ground heightfield s"}
    assert not len(slope.segments()[1]) or slope.features()[0][:, 0].max() > 1.4  # only where it ends


@pytest.mark.slow
def test_a_ball_and_a_plate_rest_on_a_ridge():
    ball = jf.RigidBody(jf.Sphere(0.3), mass=1.0, position=(0, 0.5, 0.305), name="ball")
    plate = jf.RigidBody(jf.Box((0.8, 0.6, 0.1)), mass=1.0, position=(0, -0.5, 0.055), name="plate")
    field = ground(RIDGE)
    scene = jf.Scene([ball, plate], contacts=[jf.Contact(each, field, name=each.name) for each in (ball, plate)])
    states, info = jf.rollout(*jf.build(scene, tolerance=1e-10, solver="mprgp"), 1e-2, 20)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, :, 2], (0.3, 0.05), atol=1e-4)
