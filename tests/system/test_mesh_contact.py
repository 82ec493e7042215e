"""Triangle meshes as obstacles, as bodies and as ground: distances, balls at edges and ridges, meshes on meshes."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.mesh import MeshError
from jaxfem.rigid.shapes.nearest import square_distances


def outside_of(mesh, center=(0.0, 0.0, 0.0)):
    """The surface of a soft body's mesh as a shape."""
    used, number = np.unique(mesh.surface, return_inverse=True)
    return jf.TriangleMesh(mesh.points[used] - center, number.reshape(-1, 3))


def block(size):
    """A box as a triangle mesh about its centre."""
    return outside_of(jf.mesh.box(size, (1, 1, 1)), np.asarray(size) / 2)


ROOF = jf.TriangleMesh(  # open, a ridge along y, both sides falling at 45 degrees
    np.array([(-1, -1, -1), (0, -1, 0), (1, -1, -1), (-1, 1, -1), (0, 1, 0), (1, 1, -1)], float),
    np.array([(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)]),
)


@pytest.mark.parametrize("cells", [1, 3])
def test_distance_is_that_of_the_nearest_of_all_triangles(cells):
    shape = outside_of(jf.mesh.ball(0.3, cells))
    rng = np.random.default_rng(0)
    points = rng.normal(size=(500, 3))
    points *= rng.uniform(0.15, 0.6, (500, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    near = jax.tree.map(jnp.asarray, shape.measured())
    value, normal = jax.jit(jax.vmap(jax.value_and_grad(near.distance)))(jnp.asarray(points))
    all_of_them = np.sqrt(square_distances(np, points[:, None], shape.points[shape.triangles][None])[0].min(1))
    np.testing.assert_allclose(np.abs(value), all_of_them, atol=1e-12)
    assert (value[np.linalg.norm(points, axis=1) > 0.3] > 0).all()
    assert (value[np.linalg.norm(points, axis=1) < 0.2] < 0).all()
    np.testing.assert_allclose(jnp.linalg.norm(normal, axis=1), 1, atol=1e-9)


def test_a_block_of_triangles_has_the_distance_and_the_edges_of_a_box():
    size = (0.4, 0.6, 0.8)
    shape, box = block(size), jf.Box(size)
    points = jnp.asarray(np.random.default_rng(1).uniform(-0.7, 0.7, (300, 3)))
    near, face = jax.tree.map(jnp.asarray, shape.measured()), jnp.array([0.2, 0.1, 0.1])
    value, normal = jax.jit(jax.vmap(jax.value_and_grad(near.distance)))(jnp.concatenate([points, face[None]]))
    np.testing.assert_allclose(value[:-1], jax.jit(jax.vmap(box.distance))(points), atol=1e-12)
    np.testing.assert_allclose(value[-1], 0, atol=1e-15)  # on a face there is a normal too
    np.testing.assert_allclose(normal[-1], (1, 0, 0), atol=1e-12)
    corners, _ = shape.features()
    assert len(corners) == 8 and len(shape.segments()[1]) == 12  # the diagonals of its faces are no edges


def test_hollow_edges_are_none():
    """An L: eighteen edges, of which the one in its corner is hollow."""
    step = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    points = np.concatenate([np.column_stack([step, np.full(6, z)]) for z in (0.0, 1.0)])
    caps = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ((i, j, j + 6), (i, j + 6, i + 6))]
    triangles = [c[::-1] for c in caps] + [tuple(k + 6 for k in c) for c in caps] + sides
    shape = jf.TriangleMesh(points, np.array(triangles))
    assert len(shape.segments()[1]) == 17
    inner = jax.jit(shape.distance)(jnp.array([1.1, 1.3, 0.5]))
    np.testing.assert_allclose(inner, 0.1, atol=1e-12)


RESTS = [  # above, below (fixed, its origin at z = 0), place (x, y), height of the upper one at rest
    (jf.Sphere(0.1), block((2.0, 2.0, 0.1)), (0.1, 0.1), 0.15),
    (block((2.0, 2.0, 0.1)), jf.Box((0.5, 0.5, 0.5)), (0, 0), 0.3),
    (block((0.6, 0.2, 0.1)), block((0.2, 0.8, 0.2)), (0.02, 0.01), 0.15),  # across, no vertex of either on the other
    (jf.Capsule(0.1, 1.0), block((0.2, 0.5, 0.2)), (0.02, 0), 0.2),  # laid down below
]


@pytest.mark.slow
def test_bodies_rest_on_meshes_and_meshes_on_bodies():
    tops, bottoms = [], []
    for k, (above, below, (x, y), height) in enumerate(RESTS):
        turn = (np.sqrt(0.5), 0, np.sqrt(0.5), 0) if isinstance(above, jf.Capsule) else (1, 0, 0, 0)
        place = (3.0 * k + x, y, height + 0.002)
        tops.append(jf.RigidBody(above, mass=1.0, position=place, orientation=turn, name=f"top {k}"))
        bottoms.append(jf.RigidBody(below, mass=1.0, position=(3.0 * k, 0, 0), fixed=True, name=f"base {k}"))
    contacts = [jf.Contact(top, bottom) for top, bottom in zip(tops, bottoms, strict=True)]
    model, params, state = jf.build(jf.Scene([*tops, *bottoms], contacts=contacts), tolerance=1e-9, solver="mprgp")
    states, info = scenes.rolled(model, params, state, 1e-2, 40)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, : len(RESTS), 2], [each[-1] for each in RESTS], atol=2e-4)
    np.testing.assert_allclose(states.rigid.velocities[-1, : len(RESTS)], 0, atol=2e-3)


def test_a_ball_rests_on_the_ridge_of_a_mesh_that_is_ground():
    ball = jf.RigidBody(jf.Sphere(0.2), mass=1.0, position=(0, 0, 0.205))
    scene = jf.Scene([ball], contacts=[jf.Contact(ball, ROOF)])
    states, info = jf.rollout(*jf.build(scene, tolerance=1e-10), 1e-2, 20)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, 0], (0, 0, 0.2), atol=1e-6)


@pytest.mark.slow
def test_derivative_of_a_bounce_off_the_ridge():
    ball = jf.RigidBody(jf.Sphere(0.2), mass=1.0, position=(0.03, 0, 0.21), velocity=(0.1, 0.2, -1.0))
    scene = jf.Scene([ball], contacts=[jf.Contact(ball, ROOF, friction=0.03)])
    model, params, state = jf.build(scene, tolerance=1e-13)

    def place(friction, aside):
        contacts = {n: v.replace(friction=friction * v.friction) for n, v in params.contacts.items()}
        rigid = state.rigid.replace(positions=state.rigid.positions.at[0, 0].set(0.03 * aside))
        states, _ = jf.rollout(model, params.replace(contacts=contacts), state.replace(rigid=rigid), 5e-3, 6)
        return states.rigid.positions[-1, 0] @ jnp.array([1.0, 0.5, 0.3]) + states.rigid.angular_velocities[-1, 0, 1]

    derivatives.check(place, (1.0, 1.0), forwards=False)


def test_a_mesh_that_is_none_is_refused_as_ground():
    ball = jf.RigidBody(jf.Sphere(0.2), mass=1.0)
    bad = jf.TriangleMesh(ROOF.points, ROOF.triangles + 9)
    with pytest.raises(MeshError, match="outside 0 to 5"):
        jf.build(jf.Scene([ball], contacts=[jf.Contact(ball, bad)]))
