"""Stress in frames of bodies at finite strain, against the derivative of their energy density by the stretches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.system.inside import in_world, tensors


@pytest.mark.parametrize("strain", ["element", "nodal_volume", "smoothed"])
def test_stress_of_an_even_stretch_is_that_of_its_energy(strain):
    """sigma_i = (dE/d lambda_i) lambda_i / (V J), E the body's energy, in the world's axes whatever the body's turn."""
    body = jf.SoftBody(
        jf.mesh.box((0.1,) * 3, cells=2), material=jf.NeoHookean(young=1e5, poisson=0.4), density=1e3, strain=strain
    )
    model, params, state = jf.build(jf.Scene([body]))
    stretches = jnp.array([1.5, 0.8, 1.1])

    def energy(each):
        return jf.energies(model, params, state.replace(positions=model.rest * each)).elastic

    wanted = jax.grad(energy)(stretches) * stretches / (1e-3 * jnp.prod(stretches))
    quarter = jnp.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = state.replace(positions=(model.rest * stretches) @ quarter.T)
    found = np.asarray(in_world(model, turned)(tensors(model, params, turned)["stress"]))
    np.testing.assert_allclose(found[:, :3], np.tile(np.asarray(wanted)[[1, 0, 2]], (len(found), 1)), rtol=1e-9)
    np.testing.assert_allclose(found[:, 3:], 0, atol=1e-4)
