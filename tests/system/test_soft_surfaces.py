"""Surfaces of two soft bodies: what hangs over an edge, and what is kept."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.system.coupled import configuration

SIDE = 0.1


def two_cubes(aside, above, **more):
    """A cube (26 nodes that touch) on another one, its corner `aside` (x, y) and a gap `above` it."""
    lower = jf.SoftBody(jf.mesh.box((SIDE,) * 3, 2), 1e6, 0.3, 1000.0, name="lower", **more)
    mesh = jf.mesh.box((SIDE,) * 3, 2, origin=(*aside, SIDE + above))
    upper = jf.SoftBody(mesh, 1e6, 0.3, 1000.0, name="upper")
    return jf.build(jf.Scene([lower, upper], contacts=[jf.Contact(upper, lower, friction=0.5)]))


@jax.jit
def pairs_of(group, state):
    return group.pairs(configuration(state))


def pairs_of_upper(model, state):
    """Positions, gaps and normals of the upper cube's nodes: the first half of the candidates."""
    (group,) = model.contacts.values()
    half = len(group.margin) // 2
    pairs = pairs_of(group, state)
    places = np.asarray(state.positions[group.points.nodes[:half, 0]])
    return places, np.asarray(pairs.gap)[:half], np.asarray(pairs.normal)[:half]


def test_what_hangs_over_an_edge_is_not_carried_by_it():
    model, _, state = two_cubes((0.03, 0.0), 0.0)
    places, gaps, normals = pairs_of_upper(model, state)
    base = np.isclose(places[:, 2], SIDE)
    beyond = base & (places[:, 0] > SIDE + 1e-9)
    assert beyond.sum() == 3
    np.testing.assert_allclose(gaps[beyond], 0.03, atol=1e-12)
    np.testing.assert_allclose(normals[beyond], [(1, 0, 0)] * 3, atol=1e-12)
    inside = base & (places[:, 0] < SIDE - 1e-9) & (places[:, 1] > 1e-9) & (places[:, 1] < SIDE - 1e-9)
    np.testing.assert_allclose(gaps[inside], 0, atol=1e-12)


def test_distance_beside_and_beyond_an_edge():
    model, _, state = two_cubes((SIDE + 0.013, 0.0), -SIDE / 2 + 0.014)
    places, gaps, _ = pairs_of_upper(model, state)
    near = np.isclose(places[:, 0], SIDE + 0.013)
    beside, over = near & (places[:, 2] < SIDE), near & (places[:, 2] > SIDE)
    np.testing.assert_allclose(gaps[beside], 0.013, atol=1e-12)
    np.testing.assert_allclose(gaps[over], np.hypot(0.013, places[over, 2] - SIDE), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("aside", "stays"), [(0.03, True), (0.07, False)])
def test_a_cube_falls_once_its_middle_is_over_the_edge(aside, stays):
    model, params, state = two_cubes((aside, 0.0), 0.0, fixed="z-")
    states, info = jf.rollout(model, params, state, 1e-2, 40)
    assert not info.status.any()
    sunk = 1.5 * SIDE - float(states.positions[-1, model.nodes // 2 :, 2].mean())
    assert (sunk < 2e-3) == stays


def test_momentum_is_kept():
    model, params, state = two_cubes((0.013, 0.021), 1e-3)
    velocities = jnp.where(jnp.arange(model.nodes)[:, None] < model.nodes // 2, 0.0, jnp.array([0.2, 0.1, -1.0]))
    still = params.replace(gravity=jnp.zeros(3))
    states, info = jf.rollout(model, still, state.replace(velocities=velocities), 5e-3, 20)
    assert not info.status.any()
    mass = 1000.0 * model.nodal_volumes
    momentum = jnp.einsum("n,tni->ti", mass, states.velocities)
    np.testing.assert_allclose(momentum, jnp.broadcast_to(mass @ velocities, momentum.shape), atol=1e-7)
    assert float(states.velocities[-1, : model.nodes // 2, 2].mean()) < -0.2  # the lower one has been struck
