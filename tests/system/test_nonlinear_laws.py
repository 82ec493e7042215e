"""Laws that are not linear, among contacts and joints, with their derivatives, in lanes, and in single precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

LAW = jf.NeoHookean(young=4e4, poisson=0.4, damping=3e-3)


def pressed(law=LAW, dtype=None, tolerance=None):
    """A cube on the ground, with friction, below a weight on a ball joint at its top."""
    mesh = jf.mesh.box((0.06, 0.06, 0.06), 1, origin=(-0.03, -0.03, 0.0))
    cube = jf.SoftBody(mesh, material=law, density=1e3, name="cube")
    weight = jf.RigidBody(shape=jf.Box((0.04, 0.04, 0.02)), mass=1.0, position=(0.0, 0.0, 0.072), name="weight")
    contacts = [jf.Contact("cube", jf.Plane(), friction=0.6), jf.Contact("cube", "weight", friction=0.6)]
    return jf.build(jf.Scene([cube, weight], contacts=contacts), dtype=dtype, tolerance=tolerance)


@pytest.mark.slow
def test_a_weight_presses_a_cube_as_far_as_the_law_says():
    """At rest the ground carries all, and the nodes' forces balance: contact impulses against the law's own force."""
    model, params, state = pressed()
    states, info = jf.rollout(model, params, state, 2e-2, 60)
    assert not info.status.any()
    end = jax.tree.map(lambda leaf: leaf[-1], states)
    assert float(jnp.abs(end.velocities).max()) < 1e-3
    name = next(each for each in jf.impulses(model, end) if "plane" in each.lower() and "friction" not in each)
    carried = float(jnp.sum(jf.impulses(model, end)[name])) / 2e-2
    weight = 9.81 * (1.0 + 1e3 * 0.06**3)
    np.testing.assert_allclose(carried, weight, rtol=2e-3)
    sunk = 1 - float(jnp.max(end.positions[:, 2])) / 0.06
    assert 0.04 < sunk < 0.12  # 2.9 kPa on 40 kPa, its faces held by friction


@pytest.mark.slow
def test_derivatives_through_contact():
    """In the constants and the weight: forward = reverse = central differences, on the way down."""
    model, params, state = pressed(tolerance=1e-12)

    def height(young, poisson, mass):
        own = params.replace(young=4e4 * young, poisson=poisson, rigid=params.rigid.replace(mass=mass[None]))
        return 1e2 * jf.rollout(model, own, state, 1e-2, 4)[0].rigid.positions[-1, 0, 2]

    values = jnp.array([1.0, 0.4, 1.0])
    both = jax.jit(jax.value_and_grad(lambda z: height(*z)))
    _, slopes = both(values)
    for k, h in enumerate((1e-4, 1e-4, 1e-4)):
        step = h * jnp.eye(3)[k]
        central = (both(values + step)[0] - both(values - step)[0]) / (2 * h)
        np.testing.assert_allclose(slopes[k], central, rtol=1e-5, atol=1e-9)
