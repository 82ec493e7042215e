"""Ten soft cubes on top of each other stand for ten seconds."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf

SIDE, YOUNG, DENSITY = 0.1, 1e7, 1000.0


def turned(degrees):
    """A turn about the vertical."""
    a = np.radians(degrees)
    return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])


@pytest.mark.slow
def test_ten_soft_cubes_stand_for_ten_seconds():
    corner = (-SIDE / 2, -SIDE / 2, 0)
    cubes = []
    for k in range(10):  # laid by hand: turned 10 degrees and 2 mm aside, one this way, the next that way
        mesh = jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=5, origin=corner).rotated(turned(10 * (-1) ** k))
        place = (0.002 * (-1) ** k, 0, SIDE * k)
        cubes.append(jf.SoftBody(mesh.translated(place), YOUNG, 0.3, DENSITY, damping=5e-3))
    contacts = [jf.Contact(cubes[0], jf.Plane()), *(jf.Contact(b, a) for a, b in itertools.pairwise(cubes))]
    model, params, state = jf.build(jf.Scene(cubes, contacts=contacts), tolerance=1e-6)
    states, info = scenes.rolled_fast(model, params, state, 1 / 60, 600, every=20)
    assert not info.status.any() and not info.inverted.any()
    assert float(jnp.abs(states.velocities[-1]).max()) < 1e-5
    centres = states.positions.reshape(len(states.time), 10, -1, 3).mean(2)
    assert float(jnp.abs(centres[-1, :, :2] - centres[0, :, :2]).max()) < 0.01 * SIDE
    # A column shortens by rho g L^2 / 2 E under its own weight; the faces that press on each other are uneven.
    shortening = 10 * SIDE - float(states.positions[-1, :, 2].max())
    assert shortening == pytest.approx(DENSITY * 9.81 / (2 * YOUNG), rel=0.1)
