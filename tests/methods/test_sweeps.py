"""The coupled step by Gauss-Seidel: the same answers as MPRGP, and the true friction cone."""

import derivatives
import jax.numpy as jnp
import numpy as np
import pytest
from standard import sliding_box

import jaxfem as jf


def scene():
    """A soft block welded to a hinged link with a motor, and a box that slides on a plane."""
    block = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), young=1e4, poisson=0.3, density=1000.0, damping=0.01)
    link = jf.RigidBody(jf.Box((0.3, 0.1, 0.1)), mass=0.5, position=(0.25, 0.05, 0.05))
    weld = jf.WeldJoint(block, link, nodes="x+")
    hinge = jf.HingeJoint(None, link, (0.4, 0.05, 0.05), (0, 1, 0), motor=jf.Motor(1.0, 0.5))
    floor = jf.Contact(block, jf.Plane((0, 0, -0.01)), friction=0.0)
    return jf.Scene([block, link], joints=[weld, hinge], contacts=[floor])


@pytest.mark.slow
def test_sweeps_and_mprgp_agree_where_friction_does_not_tell_them_apart():
    results = []
    for solver in ("mprgp", "pgs"):
        model, params, state = jf.build(scene(), solver=solver, tolerance=1e-9)
        states, info = jf.rollout(model, params, state, 1e-2, 8)
        assert not info.status.any()
        results.append((states.positions, states.rigid.positions))
    np.testing.assert_allclose(results[0][0], results[1][0], atol=1e-7)
    np.testing.assert_allclose(results[0][1], results[1][1], atol=1e-7)


def sliding(solver, velocity):
    return jf.build(sliding_box(velocity), solver=solver, tolerance=1e-9)


@pytest.mark.parametrize(
    ("solver", "bound"), [("pgs", 1.0), pytest.param("mprgp", np.sqrt(2.0), marks=pytest.mark.slow)]
)
def test_friction_across_the_axes(solver, bound):
    """Sliding along the diagonal of the two tangents: mu N with the cone, sqrt(2) times that with the pyramid."""
    direction = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    model, params, state = sliding(solver, 2 * direction)
    states, info = jf.rollout(model, params, state, 1e-2, 10)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.velocities[-1, 0], (2 - bound * 0.5 * 9.81 * 0.1) * direction, atol=1e-6)


@pytest.mark.slow
def test_derivatives_through_the_cone():
    model, params, state = sliding("pgs", (0.9, 0.4, 0.0))
    model = model.replace(tolerance=jnp.asarray(1e-12))
    (name,) = params.contacts

    def distance(friction, turn):
        contacts = {name: params.contacts[name].replace(friction=friction * params.contacts[name].friction)}
        velocity = state.rigid.velocities + (turn - 1) * jnp.array([[0.0, 1.0, 0.0]])
        start = state.replace(rigid=state.rigid.replace(velocities=velocity))
        states, _ = jf.rollout(model, params.replace(contacts=contacts), start, 1e-2, 6)
        return states.rigid.positions[-1, 0] @ jnp.array([1.0, 0.7, 0.0])

    derivatives.check(distance, (1.0, 1.0))
