"""Laws that are not linear, on the ground: the balance of momentum."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

LAW = jf.NeoHookean(young=1e5, poisson=0.45, damping=2e-3)


def fallen(tolerance=None):
    """A cube just above the ground, with friction."""
    mesh = jf.mesh.box((0.06, 0.06, 0.06), 2, origin=(-0.03, -0.03, 0.001))
    cube = jf.SoftBody(mesh, material=LAW, density=1e3, name="cube")
    return jf.build(jf.Scene([cube], contacts=[jf.Contact("cube", jf.Plane(), friction=0.5)]), tolerance=tolerance)


@pytest.mark.slow
def test_a_cube_lands_on_the_ground():
    """Never through it, and carried by it: the mean push over the landing is the weight and the momentum lost."""
    model, params, state = fallen()
    states, info = jf.rollout(model, params, state, 5e-3, 12)
    assert not info.status.any()
    assert float(states.positions[..., 2].min()) > -1e-9
    mass = 1e3 * 0.06**3
    pushed = {k: v for k, v in jf.impulses(model, states).items() if "friction" not in k}
    carried = sum(float(jnp.sum(each)) for each in pushed.values())
    nodal = np.asarray(model.nodal_volumes) * 1e3
    fall = float(jnp.sum(nodal * states.velocities[-1][:, 2]))
    np.testing.assert_allclose(carried, fall + 9.81 * mass * 12 * 5e-3, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("law", [jf.Linear(young=1e5, poisson=0.45, damping=2e-3), LAW], ids=["linear", "neo_hookean"])
@pytest.mark.parametrize(
    ("size", "aside", "most"),
    [(0.08, 0.0, 600), (0.03, 0.0, 6000), (0.03, 0.007, 3000)],
    ids=["wide", "half", "shifted"],
)
def test_a_weight_that_lies_flat_on_a_soft_cube_takes_few_iterations(law, size, aside, most):
    """With friction on both sides: triangles that lie flat say nothing that their corners do not, and have no rows; of
    a weight that is smaller, corners and triangles say nearly the same, and yield by a thousandth."""
    mesh = jf.mesh.box((0.06, 0.06, 0.06), 2, origin=(-0.03, -0.03, 0.0))
    cube = jf.SoftBody(mesh, material=law, density=1e3, name="cube")
    weight = jf.RigidBody(jf.Box((size, size, 0.02)), mass=0.5, position=(aside, aside / 2, 0.07), name="weight")
    contacts = [jf.Contact("cube", jf.Plane(), friction=0.5), jf.Contact("cube", "weight", friction=0.5)]
    states, info = jf.rollout(*jf.build(jf.Scene([cube, weight], contacts=contacts), solver="condensed"), 5e-3, 5)
    assert not info.status.any()
    assert int(info.iterations.max()) < most  # thousands each step, and a status, with rows said twice
    assert float(states.positions[..., 2].min()) > -1e-9
