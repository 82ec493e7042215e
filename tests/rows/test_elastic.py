"""Elastic rows: operator identities, and their sum on the nodes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

from jaxfem.bodies.elasticity import elastic_energy
from jaxfem.bodies.elements import deformation_gradient, rotation_of
from jaxfem.model import nodal_mass, per_element
from jaxfem.routes.assembly import assemble, tangent_blocks
from jaxfem.routes.condensed import condensed_matrix
from jaxfem.routes.preconditioner import inverse_blocks
from jaxfem.routes.system import momentum_gradient, step_system
from jaxfem.tensors import array_of

RNG = np.random.default_rng(2)


def product(matrix, pattern, vector):
    """Product in the user's order of nodes."""
    return pattern.scattered(matrix.apply(pattern.gathered(vector)))


def deformed(dtype=None, amount=0.003, **kwargs):
    model, params, state = scenes.beam(build={"dtype": dtype}, **kwargs)
    noise = amount * RNG.standard_normal(state.positions.shape)
    moved = state.replace(
        positions=jnp.asarray(state.positions + noise, model.rest.dtype),
        velocities=jnp.asarray(RNG.standard_normal(noise.shape), model.rest.dtype),
    )
    return model, params, moved


def system_of(model, params, state, dt=1e-2):
    return step_system(model, params, state, jnp.asarray(dt, model.rest.dtype), None)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_apply_and_transpose_are_adjoint(dtype):
    system = system_of(*deformed(dtype))
    (rows,) = system.rows
    v = jnp.asarray(RNG.standard_normal(system.target.shape), dtype)
    lam = jnp.asarray(RNG.standard_normal(rows.bias.shape), dtype)
    left, right = jnp.vdot(rows.apply(v), lam), jnp.vdot(v, rows.apply_transpose(lam))
    assert rows.apply(v).dtype == dtype
    np.testing.assert_allclose(left, right, rtol=5e3 * jnp.finfo(dtype).eps)


def test_diagonal_is_that_of_the_operator():
    system = system_of(*deformed(cells=(2, 1, 1)))
    (rows,) = system.rows
    inverse_mass = system.free / system.mass
    basis = jnp.eye(rows.bias.size).reshape(-1, *rows.bias.shape)
    columns = jax.vmap(lambda lam: rows.apply(inverse_mass[:, None] * rows.apply_transpose(lam)))(basis)
    exact = jnp.diagonal(columns.reshape(rows.bias.size, -1)).reshape(rows.bias.shape)
    np.testing.assert_allclose(rows.diagonal(inverse_mass), exact, rtol=1e-12)


def test_rows_apply_to_the_rate_of_rotated_strain():
    """Along a motion without rotation J v is the rate of the strain: compared with differences at the rest shape."""
    model, params, state = scenes.beam(cells=(2, 2, 2))
    (rows,) = system_of(model, params, state).rows
    v = jnp.asarray(RNG.standard_normal(state.positions.shape))
    h = 1e-7

    def strain(positions):
        moved = system_of(model, params, state.replace(positions=positions), 1e-2)
        return -moved.rows[0].bias * (1e-2 + params.damping)

    rate = (strain(state.positions + h * v) - strain(state.positions - h * v)) / (2 * h)
    np.testing.assert_allclose(rows.apply(v), rate, atol=1e-6 * float(jnp.abs(rate).max()))


def test_condensed_matrix_is_the_hessian_of_the_condition():
    """M + J' C^-1 J assembled = derivative of the residual = M + dt (dt + beta) K of the warped stiffness."""
    model, params, state = deformed()
    system = system_of(model, params, state)
    v = jnp.asarray(RNG.standard_normal(state.positions.shape))
    _, exact = jax.jvp(lambda u: momentum_gradient(system, u), (jnp.zeros_like(v),), (v,))
    found = product(condensed_matrix(system), system.pattern, v)
    np.testing.assert_allclose(found, exact, atol=1e-12 * float(jnp.abs(exact).max()))


def test_damping_at_row_level_is_m_plus_dt_dt_plus_beta_k():
    model, params, state = deformed()
    dt, beta = 1e-2, 5e-3
    params = params.replace(damping=jnp.asarray(beta))
    v = jnp.asarray(RNG.standard_normal(state.positions.shape)) * model.free[:, None]
    mass = nodal_mass(model, params.density)[:, None] * v

    def k_times(damping, step):
        system = system_of(model, params.replace(damping=jnp.asarray(damping)), state, step)
        return (product(condensed_matrix(system), system.pattern, v) - mass) / (step * (step + damping))

    stiffness = k_times(0.0, 1.0)
    np.testing.assert_allclose(k_times(beta, dt), stiffness, atol=1e-9 * float(jnp.abs(stiffness).max()))


def test_matrix_is_symmetric_and_float32_matches():
    system = system_of(*deformed())
    matrix = condensed_matrix(system)
    u, v = jnp.asarray(RNG.standard_normal((2, *matrix.diagonal_blocks.shape[:2])))
    np.testing.assert_allclose(jnp.vdot(u, matrix.apply(v)), jnp.vdot(v, matrix.apply(u)), rtol=1e-11)
    blocks = matrix.diagonal_blocks
    identity = jnp.einsum("nij,njk->nik", inverse_blocks(blocks), blocks)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=1e-12)


@pytest.mark.parametrize("amount", [0.0, 0.003, 0.02])
def test_tangent_blocks_are_the_hessian_of_the_energy(amount):
    """Also where 20 mm of noise on 15 mm cells turns elements inside out."""
    model, params, state = deformed(amount=amount, fixed=None)
    young, poisson = per_element(model, params.young), per_element(model, params.poisson)

    def energy(positions):
        return jnp.sum(elastic_energy(model.elements, positions, young, poisson))

    v = jnp.asarray(RNG.standard_normal(state.positions.shape))
    exact = jax.jvp(jax.grad(energy), (state.positions,), (v,))[1]
    zero = jnp.zeros(model.nodes)
    rotation = array_of(rotation_of(deformation_gradient(model.elements, state.positions), "polar"))
    blocks = tangent_blocks(model.elements, state.positions, rotation, young, poisson)
    found = product(assemble(blocks, zero, model.free, model.pattern), model.pattern, v)
    np.testing.assert_allclose(found, exact, atol=1e-9 * float(jnp.abs(exact).max()))
