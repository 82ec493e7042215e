"""Coupled scenes by the condensed route: MPRGP's answer on all rows, its derivatives, batches, single precision."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

SOFT = {"poisson": 0.3, "density": 1000.0, "damping": 2e-3}


def block_on_plane():
    """A soft block that lands on rough ground and slides."""
    mesh = jf.mesh.box((0.2, 0.2, 0.1), (2, 2, 1), origin=(0, 0, 0.01))
    body = jf.SoftBody(mesh, young=2e4, velocity=(0.6, 0.2, -1.0), **SOFT)
    return jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=0.5)])


def ball_on_block():
    """A rigid ball that falls on a soft block, nearly incompressible and smoothed."""
    mesh = jf.mesh.box((0.2, 0.2, 0.1), (2, 2, 1), origin=(-0.1, -0.1, 0))
    body = jf.SoftBody(mesh, young=5e4, fixed="z-", strain="smoothed", **{**SOFT, "poisson": 0.49})
    ball = jf.RigidBody(jf.Sphere(0.05), mass=2.0, position=(0.02, 0.01, 0.17), velocity=(0.3, 0, -1))
    return jf.Scene([body, ball], contacts=[jf.Contact(body, ball, friction=0.4)])


def arm_with_tool():
    """A soft arm, a rigid tool welded to it, and on a hinge with limits and a weak motor a second one."""
    mesh = jf.mesh.box((0.2, 0.05, 0.05), (3, 1, 1))
    body = jf.SoftBody(mesh, young=1e5, fixed="x-", **SOFT)
    tool = jf.RigidBody(jf.Box((0.1, 0.05, 0.05)), mass=0.1, position=(0.25, 0.025, 0.025))
    tip = jf.RigidBody(jf.Box((0.1, 0.02, 0.02)), mass=0.05, position=(0.35, 0.025, 0.025))
    hinge = jf.HingeJoint(tool, tip, (0.3, 0.025, 0.025), (0, 1, 0), low=-0.1, high=0.2, motor=jf.Motor(2.0, 0.004))
    return jf.Scene([body, tool, tip], joints=[jf.WeldJoint(body, tool, nodes="x+", compliance=1e-6), hinge])


def run(scene, solver, tolerance=1e-9, dtype=jnp.float64):
    model, params, state = jf.build(scene, solver=solver, tolerance=tolerance, dtype=dtype)
    assert model.method.name == solver
    states, info = jf.rollout(model, params, state, 1e-2, 12)
    assert not info.status.any()
    return states, info, jf.impulses(model, states)


@pytest.mark.parametrize("make", [block_on_plane, ball_on_block, arm_with_tool])
def test_mprgp_on_all_rows_gives_the_same(make):
    scene = make()
    (found, info, own), (expected, other, theirs) = run(scene, "condensed"), run(scene, "mprgp")
    np.testing.assert_allclose(found.positions, expected.positions, atol=2e-8)
    np.testing.assert_array_equal(info.weakly_active, other.weakly_active)
    if found.rigid is not None:
        np.testing.assert_allclose(found.rigid.positions, expected.rigid.positions, atol=2e-8)
        np.testing.assert_allclose(found.rigid.orientations, expected.rigid.orientations, atol=2e-7)
    assert set(own) == {name for name in theirs if not name.startswith("elastic")}
    for name, impulses in own.items():
        size = float(jnp.abs(theirs[name]).max() + 1e-3)
        np.testing.assert_allclose(impulses, theirs[name], atol=1e-6 * size, err_msg=name)


def test_single_precision_follows():
    single, _, _ = run(arm_with_tool(), "condensed", 1e-5, jnp.float32)
    double, _, _ = run(arm_with_tool(), "condensed")
    assert single.positions.dtype == jnp.float32
    np.testing.assert_allclose(single.positions, double.positions, atol=2e-5)


def sliding_block():
    """Model, params, state of the block, and where it is after some steps as a function of stiffness and friction."""
    model, params, state = jf.build(block_on_plane(), tolerance=1e-12)
    (name,) = params.contacts

    def place(young, friction):
        contacts = {name: params.contacts[name].replace(friction=friction * params.contacts[name].friction)}
        values = params.replace(young=young * params.young, contacts=contacts)
        states, _ = jf.rollout(model, values, state, 1e-2, 4)
        return jnp.mean(states.positions[-1] @ jnp.array([1.0, 0.4, 0.5]))

    return place


def test_derivatives_where_friction_slides():
    """The derivative's system is not symmetric there."""
    derivatives.check(sliding_block(), (1.0, 1.0))


def test_lanes_of_a_batch():
    place, young = sliding_block(), jnp.array([0.8, 1.3])
    lanes = jax.jit(jax.vmap(lambda e: place(e, 1.0)))(young)
    np.testing.assert_allclose(lanes, [place(each, 1.0) for each in young], atol=1e-9)
