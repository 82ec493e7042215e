"""What is differentiated is what build returned: traced numbers in a scene, and friction where there are no rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import Parted

import jaxfem as jf

MESH = jf.mesh.box((0.1, 0.1, 0.1), 1)


@pytest.mark.parametrize(
    ("declare", "text"),
    [
        (lambda v: jf.SoftBody(MESH, young=v, poisson=0.3, density=1e3), "young of a SoftBody"),
        (lambda v: jf.RigidBody(jf.Box((v, 1, 1)), mass=1.0), "shape of a RigidBody"),
        (lambda v: jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, v)), "position of a RigidBody"),
        (lambda v: jf.Contact("a", jf.Plane((0, 0, v))), "b of a Contact"),
        (lambda v: jf.Contact("a", "b", friction=v), "friction of a Contact"),
        (lambda v: jf.HingeJoint(None, "b", (0, 0, v), (0, 1, 0)), "anchor of a HingeJoint"),
        (lambda v: jf.Motor(v, 1.0), "target of a Motor"),
        (lambda v: jf.Scene([jf.RigidBody(jf.Sphere(0.1), mass=1.0)], gravity=(0, 0, v)), "gravity of a Scene"),
        (lambda v: jf.Traction("x+", (0, 0, v)), "traction of a Traction"),
    ],
)
def test_a_traced_number_in_a_declaration_points_to_params(declare, text):
    def inside(value):
        declare(value)
        return value

    with pytest.raises(jf.SceneError, match=text) as problem:
        jax.grad(inside)(1.0)
    assert "params.replace" in str(problem.value) and "docs/derivatives.md" in str(problem.value)


def test_friction_without_rows_for_it_has_a_status_that_says_what_to_do():
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 0.1), velocity=(1.0, 0, 0))
    model, params, state = jf.build(jf.Scene([ball], contacts=[jf.Contact(ball, jf.Plane(), friction=0.0)]))
    (name,) = params.contacts
    rough = params.replace(contacts={name: params.contacts[name].replace(friction=jnp.array([0.3]))})
    for values, good in ((params, True), (rough, False)):
        _, info = jf.step(model, values, state, 1e-2)
        assert (int(info.status) == 0) == good
    text = jf.solvers.describe(info.status)
    assert "friction" in text and "Declare a friction above 0" in text


@pytest.mark.slow
def test_single_precision_derivatives_of_a_box_that_has_stopped_are_those_of_the_way_it_slid():
    body = jf.RigidBody(jf.Box((0.2, 0.2, 0.2)), mass=1.0, position=(0, 0, 0.1))
    contact = jf.Contact(body, jf.Plane(), friction=0.3)
    model, params, state = jf.build(jf.Scene([body], contacts=[contact]), dtype=jnp.float32)
    (name,) = params.contacts

    @Parted
    def way(friction, velocity, dt):
        values = params.replace(contacts={name: params.contacts[name].replace(friction=friction * jnp.ones(8))})
        start = state.replace(rigid=state.rigid.replace(velocities=velocity[None]))
        states, _ = jf.rollout(model, values, start, dt, 40)
        return states.rigid.positions[-1, 0, 0]

    for velocity, friction, dt in (((1.0, 0, 0), 0.3, 1 / 60), ((0.5, -0.2, 0), 0.5, 1e-2), ((0.3, 0, 0), 0.3, 5e-3)):
        given = (jnp.float32(friction), jnp.array(velocity, jnp.float32), jnp.float32(dt))
        of_friction, of_speed, _ = way.backwards(*given)
        # Each step takes mu g dt off, and the last what is left. Four corners that stick are redundant, and at rest
        # some may push against others with all that they can.
        pull = friction * 9.81 * dt
        count = np.floor(velocity[0] / pull)
        np.testing.assert_allclose(of_friction, -9.81 * dt**2 * count * (count + 1) / 2, rtol=1e-4)
        np.testing.assert_allclose(of_speed[0], count * dt, rtol=1e-4)
