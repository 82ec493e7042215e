"""Faces laid rim on rim: what is a hair beyond the other's edge is carried by the face that its surface looks at."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf

SIDE, YOUNG, DENSITY = 0.1, 1e5, 1000.0


def cube(height, name):
    mesh = jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=5, origin=(-SIDE / 2, -SIDE / 2, height))
    return jf.SoftBody(mesh, YOUNG, 0.3, DENSITY, damping=5e-3, name=name)


def block_surface():
    mesh = jf.mesh.box((SIDE, SIDE, SIDE), 1, origin=(-SIDE / 2,) * 3)
    return jf.TriangleMesh(mesh.points, mesh.surface)


def settled(bodies, contacts, dtype=jnp.float64):
    model, params, state = jf.build(jf.Scene(bodies, contacts=contacts), dtype=dtype)
    states, info = jf.rollout(model, params, state, 1 / 60, 60)
    assert not info.status.any()
    return model, states, int(info.iterations.sum())


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_cubes_of_one_mesh_carry_each_other_at_their_rims(dtype):
    lower, upper = cube(0.0, "lower"), cube(SIDE, "upper")
    contacts = [jf.Contact(lower, jf.Plane()), jf.Contact(upper, lower, friction=0.5)]
    _, states, iterations = settled([lower, upper], contacts, dtype)
    # Node on node: those of the upper face and of the lower one are in one place, at the rim as in the middle.
    rest, places = (np.asarray(each, float).reshape(2, -1, 3) for each in (states.positions[0], states.positions[-1]))
    top, base = np.isclose(rest[0, :, 2], SIDE, atol=5e-3), np.isclose(rest[1, :, 2], SIDE, atol=5e-3)
    order = [np.lexsort(np.round(rest[k][face], 2).T) for k, face in ((0, top), (1, base))]
    apart = places[1][base][order[1], 2] - places[0][top][order[0], 2]
    assert np.abs(apart).max() < 2e-4 * SIDE
    assert iterations < 4000


SHAPES = {
    "box": jf.Box((SIDE, SIDE, SIDE)),
    "thin box": jf.Box((SIDE, SIDE, SIDE / 10)),
    "mesh": block_surface(),
    "cylinder": jf.Cylinder(SIDE / np.sqrt(2), SIDE),  # its rim goes through the cube's corners
}


@pytest.mark.parametrize(("name", "ground"), [("box", False), ("thin box", True), ("mesh", True), ("cylinder", False)])
def test_a_soft_cube_stands_on_a_shape_of_its_own_outline(name, ground):
    shape = SHAPES[name]
    half = SIDE / 20 if name == "thin box" else SIDE / 2
    soft = cube(half, "cube")
    below = shape if ground else jf.RigidBody(shape, mass=1.0, fixed=True, name="below")
    bodies = [soft] if ground else [soft, below]
    _, states, iterations = settled(bodies, [jf.Contact(soft, below, friction=0.5)])
    face = np.isclose(soft.mesh.points[:, 2], half)
    sunk = np.asarray(states.positions[-1])[face, 2] - half
    assert np.abs(sunk).max() < 1e-5 * SIDE
    assert iterations < 6000


def test_a_rigid_box_lies_level_on_a_soft_cube_of_its_own_outline():
    soft = cube(0.0, "cube")
    box = jf.RigidBody(jf.Box((SIDE, SIDE, SIDE)), mass=1.0, position=(0, 0, 1.5 * SIDE), name="box")
    contacts = [jf.Contact(soft, jf.Plane()), jf.Contact(soft, box, friction=0.5)]
    _, states, _ = settled([soft, box], contacts)
    under = float(states.rigid.positions[-1, 0, 2]) - SIDE / 2
    face = np.isclose(soft.mesh.points[:, 2], SIDE)
    np.testing.assert_allclose(np.asarray(states.positions[-1])[face, 2], under, atol=2e-4 * SIDE)


def test_a_soft_cube_stands_on_an_open_surface_that_is_ground():
    """It has no middle that its corners would end away from."""
    places = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * SIDE
    soft = cube(0.0, "cube")
    ground = jf.TriangleMesh(places, [[0, 1, 2], [0, 2, 3]])
    _, states, _ = settled([soft], [jf.Contact(soft, ground)])
    base = np.isclose(soft.mesh.points[:, 2], 0)
    assert np.abs(np.asarray(states.positions[-1])[base, 2]).max() < 1e-5 * SIDE


def test_a_soft_cube_stands_in_a_hollow_corner():
    """Floor and two walls of one surface: a node near two faces is held by the one that it is in, or nearer to."""
    places = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], float)
    faces = [[0, 1, 2], [0, 2, 3], [0, 4, 5], [0, 5, 1], [0, 3, 6], [0, 6, 4]]
    soft = jf.SoftBody(jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=5), YOUNG, 0.3, DENSITY, damping=5e-3, name="cube")
    _, states, _ = settled([soft], [jf.Contact(soft, jf.TriangleMesh(places, faces), friction=0.3)])
    assert float(states.positions[-1].min()) > -1e-4 * SIDE


def test_what_is_far_beyond_an_edge_hangs_free():
    soft = jf.SoftBody(jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=5), YOUNG, 0.3, DENSITY, name="cube")
    box = jf.RigidBody(jf.Box((SIDE, SIDE, SIDE)), mass=1.0, position=(0.8 * SIDE, SIDE / 2, -SIDE / 2), fixed=True)
    model, _, state = jf.build(jf.Scene([soft, box], contacts=[jf.Contact(soft, box)]))
    group = next(each for each in model.contacts.values() if each.kind.startswith("soft-rigid"))
    pairs = group.pairs(jf.system.coupled.configuration(state))
    places = np.asarray(state.positions)[np.asarray(group.points.nodes)[:, 0]]
    beyond = np.isclose(places[:, 0], 0) & np.isclose(places[:, 2], 0)
    assert beyond.sum() == 3
    np.testing.assert_allclose(np.asarray(pairs.gap)[beyond], 0.3 * SIDE, rtol=0.01)


def test_derivatives_of_a_node_at_an_edge():
    """A hair beyond the edge and above it: the gap is the height over the face, not the way from the edge."""
    soft = cube(SIDE / 2, "cube")
    box = jf.RigidBody(jf.Box((SIDE,) * 3), mass=1.0, fixed=True, name="box")
    model, _, state = jf.build(jf.Scene([soft, box], contacts=[jf.Contact(soft, box)]))
    group = next(each for each in model.contacts.values() if each.kind.startswith("soft-rigid"))
    beyond = np.asarray(state.positions) * np.array([1 + 1e-5, 1 + 1e-5, 1.0]) + np.array([0, 0, 1e-8])

    @jax.jit
    def gaps(across, up):
        moved = state.replace(positions=jnp.asarray(beyond) + across * jnp.array([0.8, -0.6, 0.3]) + up * jnp.eye(3)[2])
        gap = group.pairs(jf.system.coupled.configuration(moved)).gap
        return gap @ np.cos(np.arange(len(gap)))  # all of them, each with a weight

    check(gaps, (3e-9, 2e-9), h=1e-8)
    gap = group.pairs(jf.system.coupled.configuration(state.replace(positions=jnp.asarray(beyond)))).gap
    base = np.isclose(beyond[np.asarray(group.points.nodes)[:, 0], 2], SIDE / 2, atol=1e-5)
    np.testing.assert_allclose(np.asarray(gap)[base], 1e-8, atol=1e-12)
