"""Faces of soft bodies against what is thinner than their triangles: small bodies, ridges, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.rows.faces import _deepest

SHAPES = [jf.Sphere(0.1), jf.Capsule(0.05, 0.4), jf.Box((0.1, 0.2, 0.6)), jf.Cylinder(0.1, 0.3)]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_the_deepest_point_of_a_triangle_is_no_shallower_than_any_other(shape):
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(100, 1, 3)) * 0.15 + rng.normal(size=(100, 3, 3)) * 0.15
    weights = np.asarray(jax.jit(jax.vmap(lambda c: _deepest(shape, c)))(jnp.asarray(corners)))
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-12)
    assert weights.min() > -1e-9
    steps = np.arange(41) / 40
    every = np.array([(a, b, 1 - a - b) for a in steps for b in steps if a + b < 1 + 1e-9])
    distance = jax.jit(jax.vmap(jax.vmap(shape.distance)))
    found = np.asarray(distance(jnp.einsum("mk,mki->mi", weights, corners)[:, None]))[:, 0]
    sampled = np.asarray(distance(jnp.einsum("sk,mki->msi", every, corners))).min(1)
    assert (found - sampled).max() < 5e-4  # of triangles about 0.3 wide


def cube(cells, **more):
    return jf.SoftBody(
        jf.mesh.box((0.2, 0.2, 0.2), cells), **{"young": 1e5, "poisson": 0.3, "density": 500.0, "damping": 0.02, **more}
    )


@pytest.mark.slow
def test_small_bodies_rest_on_the_face_of_a_soft_cube():
    """A ball, a box and a rod that hangs over on both sides, all thinner than the nodes are apart."""
    body, half = cube(2, fixed="z-", name="cube"), np.sqrt(0.5)
    ball = jf.RigidBody(jf.Sphere(0.02), mass=0.02, position=(0.05, 0.03, 0.225), name="ball")
    box = jf.RigidBody(jf.Box((0.04, 0.04, 0.04)), mass=0.02, position=(0.15, 0.06, 0.225), name="box")
    rod = jf.RigidBody(
        jf.Capsule(0.01, 0.3), mass=0.02, position=(0.1, 0.15, 0.215), orientation=(half, 0, half, 0), name="rod"
    )
    contacts = [jf.Contact(body, each) for each in (ball, box, rod)]
    model, params, state = jf.build(jf.Scene([body, ball, box, rod], contacts=contacts), tolerance=1e-7)
    states, info = scenes.rolled(model, params, state, 1 / 120, 50)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, :, 2], (0.22, 0.22, 0.21), atol=4e-3)
    assert float(np.abs(states.rigid.velocities[-1]).max()) < 0.02
    assert float(np.abs(states.rigid.orientations[-1, 1, 0])) > 0.999


@pytest.mark.slow
def test_a_soft_cube_does_not_fall_over_a_ridge_between_its_nodes():
    body = cube(1)
    ridge = jf.RigidBody(jf.Box((1.0, 0.02, 0.1)), mass=1.0, position=(0, 0.1, -0.055), fixed=True, name="ridge")
    model, params, state = jf.build(jf.Scene([body, ridge], contacts=[jf.Contact(body, ridge)]), tolerance=1e-8)
    states, info = scenes.rolled(model, params, state, 1e-2, 20)
    assert not info.status.any()
    # Its middle stays a little below where it began, 5 mm above the ridge; free fall would be 196 mm.
    assert float(states.positions[-1].mean(0)[2]) > 0.1 - 0.03


@pytest.mark.slow
def test_derivative_of_a_small_ball_that_bounces_off_a_face():
    body = cube(1, fixed="z-", name="cube")
    ball = jf.RigidBody(jf.Sphere(0.03), mass=0.05, position=(0.12, 0.07, 0.24), name="ball", velocity=(0.5, 0, -1))
    model, params, state = jf.build(
        jf.Scene([body, ball], contacts=[jf.Contact(body, ball, friction=0.1)]), tolerance=1e-12
    )

    def place(friction, young, aside):
        contacts = {n: v.replace(friction=friction * v.friction) for n, v in params.contacts.items()}
        rigid = state.rigid.replace(positions=state.rigid.positions.at[0, 0].set(0.12 * aside))
        values = params.replace(contacts=contacts, young=young * params.young)
        states, _ = jf.rollout(model, values, state.replace(rigid=rigid), 5e-3, 6)
        return states.rigid.positions[-1, 0] @ jnp.array([1.0, 0.5, 0.3]) + states.rigid.angular_velocities[-1, 0, 1]

    derivatives.check(place, (1.0, 1.0, 1.0), forwards=False)


def test_faces_are_left_out_where_nodes_will_do_and_there_where_asked_for():
    plate = jf.RigidBody(jf.Box((1.0, 1.0, 0.2)), mass=1.0, position=(0, 0, -0.2), fixed=True, name="plate")
    pin = jf.RigidBody(jf.Sphere(0.02), mass=1.0, position=(0, 0, 0.5), name="pin")

    def groups(other, **more):
        body = cube(2)
        return set(jf.build(jf.Scene([body, other], contacts=[jf.Contact(body, other, **more)]))[0].contacts)

    nodes = {"rough soft-rigid box", "rough rigid corner-soft 48"}
    assert groups(plate) == nodes
    assert groups(plate, faces=True) == nodes | {"rough soft faces-rigid box 0"}
    assert groups(pin) == {"rough soft-rigid sphere", "rough soft faces-rigid sphere 0"}
    assert groups(pin, faces=False) == {"rough soft-rigid sphere"}
