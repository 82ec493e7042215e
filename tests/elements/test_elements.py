"""Kinematics of linear tetrahedra: exact for affine fields, frame-indifferent, consistent with their energy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.elements.elasticity import elastic_force
from jaxfem.elements.tetra import deformation_gradient, rotated_strain, rotation_of, tetra_gradient
from jaxfem.energies import total_elastic_energy
from jaxfem.model import domain_materials
from jaxfem.tensors import array_of

RNG = np.random.default_rng(1)


@pytest.fixture(scope="module", params=["element", "nodal_volume", "smoothed"])
def block(request):
    mesh = jf.mesh.box((1.0, 1.2, 0.9), (3, 3, 2), tets_per_cell=12)
    inner = np.setdiff1d(np.arange(len(mesh.points)), mesh.surface_nodes)
    points = mesh.points.copy()
    points[inner] += 0.04 * RNG.standard_normal((len(inner), 3))
    mesh = jf.TetMesh(points, mesh.cells)
    body = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, strain=request.param)
    return jf.build(jf.Scene([body], gravity=(0, 0, 0)))


@jax.jit
def force(model, params, positions):
    return elastic_force(model.domains, positions, domain_materials(model, params))


@jax.jit
def energy_gradient(model, params, positions):
    return jax.grad(lambda x: total_elastic_energy(model, params, x))(positions)


@functools.partial(jax.jit, static_argnames="kind")
def strain_of(elements, positions, kind):
    deformation = deformation_gradient(elements, positions)
    return jnp.stack(rotated_strain(deformation, rotation_of(deformation, kind)))


def test_gradient_is_exact_for_affine_fields(block):
    model, _, state = block
    matrix = RNG.standard_normal((3, 3))
    field = state.positions @ matrix.T + 2.0
    found = np.asarray(array_of(tetra_gradient(model.elements.cells, model.elements.gradients, field)))
    np.testing.assert_allclose(found, np.broadcast_to(matrix[:, :, None], found.shape), atol=1e-12)


@pytest.mark.parametrize("kind", ["polar", "gram_schmidt"])
def test_rigid_motion_strains_nothing(block, kind):
    model, _, state = block
    for seed in range(5):
        moved = state.positions @ scenes.random_rotation(seed).T + np.array([3.0, -2.0, 1.0])
        assert np.abs(strain_of(model.elements, moved, kind)).max() < 1e-13


@pytest.mark.parametrize("angle", [1e-8, 0.3, 1.5, np.pi - 1e-6, np.pi, 5.0])
def test_rigid_rotation_by_any_angle_gives_no_force(block, angle):
    model, params, state = block
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    turn = np.asarray(jf.rotation.rotation_vector_to_matrix(jnp.asarray(axis * angle)))
    found = force(model, params, state.positions @ turn.T)
    area = 1.0
    assert jnp.abs(found).max() < 1e-9 * float(params.young) * area


def test_warped_force_is_minus_the_gradient_of_the_energy(block):
    model, params, state = block
    x = state.positions + 0.08 * RNG.standard_normal(state.positions.shape)
    found, expected = force(model, params, x), -energy_gradient(model, params, x)
    np.testing.assert_allclose(found, expected, atol=1e-10 * float(jnp.abs(expected).max()))


def test_deformed_free_body_feels_no_net_force_or_torque(block):
    model, params, state = block
    x = state.positions + 0.08 * RNG.standard_normal(state.positions.shape)
    f = force(model, params, x)
    size = 1e6 * 1.0 * 1.0
    assert jnp.abs(f.sum(0)).max() < 1e-12 * size
    assert jnp.abs(jnp.cross(x, f).sum(0)).max() < 1e-12 * size


def test_linear_patch(block):
    """A homogeneous small strain leaves interior nodes of an irregular mesh without force."""
    model, params, state = block
    strain = 1e-6 * np.array([[1.0, 0.4, -0.2], [0.4, -0.7, 0.3], [-0.2, 0.3, 0.5]])
    f = force(model, params, state.positions @ (np.eye(3) + strain))
    rest = np.asarray(state.positions)
    inside = ((rest > 1e-9) & (rest < np.array([1.0, 1.2, 0.9]) - 1e-9)).all(1)
    assert inside.sum() >= 8
    assert jnp.abs(f[inside]).max() < 1e-8 * jnp.abs(f).max()


def test_float32_keeps_rigid_motion_clean(block):
    mesh = jf.mesh.box((1, 1, 1), (2, 2, 2))
    body = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0)
    model, params, _ = jf.build(jf.Scene([body]), dtype=jnp.float32)
    turned = (mesh.points @ scenes.random_rotation(3).T).astype(np.float32)
    found = force(model, params, jnp.asarray(turned))
    assert found.dtype == jnp.float32
    assert jnp.abs(found).max() < 3e-6 * 1e6
