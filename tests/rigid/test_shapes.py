"""Shapes: mass properties against closed forms and integrals, distances against what they mean."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.mesh import MeshError

SOLIDS = [jf.Sphere(0.3), jf.Box((0.4, 0.6, 0.8)), jf.Capsule(0.2, 0.5), jf.Cylinder(0.3, 0.7)]
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


@pytest.mark.parametrize("shape", SOLIDS, ids=lambda s: type(s).__name__)
def test_mass_properties_are_integrals_over_where_the_distance_is_negative(shape):
    volume, center, inertia = shape.mass_properties()
    step = 0.01
    axis = np.arange(-0.6 + step / 2, 0.6, step)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    inside = grid[np.asarray(jax.jit(jax.vmap(shape.distance))(grid)) < 0]
    second = inside.T @ inside / len(inside)
    np.testing.assert_allclose(len(inside) * step**3, volume, rtol=0.01)
    np.testing.assert_allclose(np.trace(second) * np.eye(3) - second, inertia, rtol=0.01, atol=1e-10)
    np.testing.assert_allclose(center, 0)


@pytest.mark.parametrize("shape", SOLIDS, ids=lambda s: type(s).__name__)
def test_distance_is_the_way_to_the_surface_along_its_gradient(shape):
    points = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (200, 3)))
    distance = jax.jit(jax.vmap(shape.distance))
    value, normal = map(np.asarray, jax.jit(jax.vmap(jax.value_and_grad(shape.distance)))(points))
    outside = value > 0.05
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-12)
    foot = np.asarray(points) - value[:, None] * normal
    assert np.abs(np.asarray(distance(foot)))[outside].max() < 1e-12
    at, radius = shape.features()
    np.testing.assert_allclose(distance(jnp.asarray(at)), -radius, atol=1e-12)


def test_a_triangle_mesh_has_the_moments_of_its_solid():
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    size = np.array([0.4, 0.6, 0.8])
    mesh = jf.TriangleMesh((CUBE * size) @ turn.T + 3, CUBE_FACES)
    volume, center, inertia = mesh.mass_properties()
    exact = jf.Box(size).mass_properties()
    np.testing.assert_allclose(volume, exact[0])
    np.testing.assert_allclose(center, turn @ size / 2 + 3)
    np.testing.assert_allclose(inertia, turn @ exact[2] @ turn.T, atol=1e-12)


@pytest.mark.parametrize(
    ("faces", "text"),
    [(CUBE_FACES[1:], "not closed"), (CUBE_FACES[:, ::-1], "inside out"), (CUBE_FACES + 9, "outside 0 to 7")],
)
def test_a_surface_that_bounds_nothing_is_refused(faces, text):
    with pytest.raises(MeshError, match=text):
        jf.TriangleMesh(CUBE, faces).mass_properties()


def test_ground_shapes():
    heights = jnp.asarray(np.add.outer(np.arange(4) * 0.5, np.arange(3) * 0.0))  # z = 0.5 x
    ground = jf.HeightField(heights, (1.0, 1.0))
    slope = jf.Plane((0, 0, 0), (-0.5, 0, 1))
    for point in ([1.3, 0.4, 2.0], [2.5, 1.9, 0.0]):
        np.testing.assert_allclose(ground.distance(jnp.array(point)), slope.distance(jnp.array(point)))
        np.testing.assert_allclose(
            jax.grad(ground.distance)(jnp.array(point)), jax.grad(slope.distance)(jnp.array(point)), atol=1e-12
        )
    np.testing.assert_allclose(ground.distance(jnp.array([9.0, 0.0, 2.5])), 1.0)  # beyond the edge: level
    ball = jf.SignedDistance(lambda p, r: jnp.linalg.norm(p) - r, 0.5)
    np.testing.assert_allclose(ball.distance(jnp.array([0.0, 2.0, 0.0])), 1.5)
