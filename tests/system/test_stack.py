"""Ten soft cubes on top of each other stand: laid by hand for ten seconds, and node on node."""

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


def stack(meshes):
    """The model, params and state of cubes on a plane, each on the one before it."""
    cubes = [jf.SoftBody(mesh, YOUNG, 0.3, DENSITY, damping=5e-3) for mesh in meshes]
    contacts = [jf.Contact(cubes[0], jf.Plane()), *(jf.Contact(b, a) for a, b in itertools.pairwise(cubes))]
    return jf.build(jf.Scene(cubes, contacts=contacts), tolerance=1e-6)


@pytest.mark.slow
def test_ten_soft_cubes_stand_for_ten_seconds():
    corner = (-SIDE / 2, -SIDE / 2, 0)
    meshes = []
    for k in range(10):  # laid by hand: turned 10 degrees and 2 mm aside, one this way, the next that way
        mesh = jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=5, origin=corner).rotated(turned(10 * (-1) ** k))
        meshes.append(mesh.translated((0.002 * (-1) ** k, 0, SIDE * k)))
    model, params, state = stack(meshes)
    states, info = scenes.rolled_fast(model, params, state, 1 / 60, 600, every=20)
    assert not info.status.any() and not info.inverted.any()
    assert float(jnp.abs(states.velocities[-1]).max()) < 1e-5
    centres = states.positions.reshape(len(states.time), 10, -1, 3).mean(2)
    assert float(jnp.abs(centres[-1, :, :2] - centres[0, :, :2]).max()) < 0.01 * SIDE
    # A column shortens by rho g L^2 / 2 E under its own weight; the faces that press on each other are uneven.
    shortening = 10 * SIDE - float(states.positions[-1, :, 2].max())
    assert shortening == pytest.approx(DENSITY * 9.81 / (2 * YOUNG), rel=0.1)


@pytest.mark.slow
def test_ten_cubes_of_one_mesh_stand_straight():
    """Rims on rims, where rounding says on which side of an edge a node is."""
    meshes = [jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=5, origin=(-SIDE / 2, -SIDE / 2, SIDE * k)) for k in range(10)]
    model, params, state = stack(meshes)
    states, info = scenes.rolled_fast(model, params, state, 1 / 60, 300, every=20)
    assert not info.status.any()
    aside = np.asarray(states.positions[-1] - state.positions).reshape(10, -1, 3).mean(1)[:, :2]
    assert np.abs(aside).max() < 1e-3 * SIDE
    shortening = 10 * SIDE - float(states.positions[-1, :, 2].max())
    assert shortening == pytest.approx(DENSITY * 9.81 / (2 * YOUNG), rel=0.05)
    assert int(info.iterations.sum()) < 5000  # it was 370,000, and 48 steps failed
