"""Elastic rows: operator identities, and their sum on the nodes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

from jaxfem.elements.domains import bulk_shares, domain_strain
from jaxfem.energies import total_elastic_energy
from jaxfem.methods.nodes.assembly import assemble_tangent
from jaxfem.methods.nodes.condensed import condensed_matrix
from jaxfem.methods.nodes.preconditioner import inverse_blocks
from jaxfem.model import domain_materials, nodal_mass
from jaxfem.system.soft import momentum_gradient, step_system
from jaxfem.tensors import array_of

RNG = np.random.default_rng(2)
STRAINS = ["element", "nodal_volume", "smoothed"]


@jax.jit
def product(matrix, pattern, vector):
    """Product in the user's order of nodes."""
    return pattern.scattered(matrix.apply(pattern.gathered(vector)))


def deformed(dtype=None, amount=0.003, mass="lumped", **kwargs):
    model, params, state = scenes.beam(build={"dtype": dtype, "mass": mass}, **kwargs)
    noise = amount * RNG.standard_normal(state.positions.shape)
    moved = state.replace(
        positions=jnp.asarray(state.positions + noise, model.rest.dtype),
        velocities=jnp.asarray(RNG.standard_normal(noise.shape), model.rest.dtype),
    )
    return model, params, moved


# Compiled as wholes: operation by operation each case would compile a hundred small programs.
assembled, begun, inverted = jax.jit(condensed_matrix), jax.jit(step_system), jax.jit(inverse_blocks)


@jax.jit
def both_ways(rows, v, lam):
    return rows.apply(v), rows.apply_transpose(lam)


@jax.jit
def diagonals(rows, inverse_mass):
    """The diagonal of J M^-1 J', as the rows give it and from all its columns."""
    basis = jnp.eye(rows.bias.size).reshape(-1, *rows.bias.shape)
    columns = jax.vmap(lambda lam: rows.apply(inverse_mass[:, None] * rows.apply_transpose(lam)))(basis)
    exact = jnp.diagonal(columns.reshape(rows.bias.size, -1)).reshape(rows.bias.shape)
    return rows.diagonal(inverse_mass), exact


@jax.jit
def measured(domains, positions):
    return jnp.stack(domain_strain(domains, positions)[0])


@jax.jit
def derivative_of_residual(system, v):
    return jax.jvp(lambda u: momentum_gradient(system, u), (jnp.zeros_like(v),), (v,))[1]


@jax.jit
def applied(matrix, vectors):
    return jax.vmap(matrix.apply)(vectors)


@jax.jit
def hessian_of_energy(model, params, positions, v):
    return jax.jvp(jax.grad(lambda x: total_elastic_energy(model, params, x)), (positions,), (v,))[1]


@jax.jit
def tangent(model, params, positions):
    rotations = [array_of(domain_strain(each, positions)[1]) for each in model.domains]
    materials, zero = domain_materials(model, params), jnp.zeros(model.nodes)
    return assemble_tangent(model.domains, positions, rotations, materials, zero, model.free, model.pattern)


def system_of(model, params, state, dt=1e-2):
    return begun(model, params, state, jnp.asarray(dt, model.rest.dtype))


@pytest.mark.parametrize("strain", STRAINS)
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_apply_and_transpose_are_adjoint(dtype, strain):
    system = system_of(*deformed(dtype, strain=strain))
    for rows in system.elastic:
        v = jnp.asarray(RNG.standard_normal(system.target.shape), dtype)
        lam = jnp.asarray(RNG.standard_normal(rows.bias.shape), dtype)
        rates, forces = both_ways(rows, v, lam)
        left, right = jnp.vdot(rates, lam), jnp.vdot(v, forces)
        assert rates.dtype == dtype
        size = np.linalg.norm(rates) * np.linalg.norm(lam)
        np.testing.assert_allclose(left, right, atol=50 * jnp.finfo(dtype).eps * size)


@pytest.mark.parametrize("strain", STRAINS)
def test_diagonal_is_that_of_the_operator(strain):
    system = system_of(*deformed(cells=(2, 1, 1), strain=strain))
    inverse_mass = system.free / system.mass
    for rows in system.elastic:
        found, exact = diagonals(rows, inverse_mass)
        np.testing.assert_allclose(found, exact, rtol=1e-12)


@pytest.mark.parametrize("strain", STRAINS)
def test_rows_apply_to_the_rate_of_rotated_strain(strain):
    """Along a motion without rotation J v is the rate of the strain: compared with differences at the rest shape."""
    model, params, state = scenes.beam(strain=strain)
    v = jnp.asarray(RNG.standard_normal(state.positions.shape))
    h = 1e-7
    for rows in system_of(model, params, state).elastic:
        ahead, behind = (measured(rows.domains, state.positions + s * h * v) for s in (1, -1))
        rate = np.asarray(ahead - behind) / (2 * h)
        np.testing.assert_allclose(both_ways(rows, v, rows.bias)[0], rate, atol=1e-6 * np.abs(rate).max())


@pytest.mark.parametrize(("strain", "mass"), [*[(s, "lumped") for s in STRAINS], ("smoothed", "averaged")])
def test_condensed_matrix_is_the_hessian_of_the_condition(strain, mass):
    """M + J' C^-1 J assembled = derivative of the residual = M + dt (dt + beta) K of the warped stiffness."""
    model, params, state = deformed(strain=strain, mass=mass)
    system = system_of(model, params, state)
    v = jnp.asarray(RNG.standard_normal(state.positions.shape))
    exact = derivative_of_residual(system, v)
    found = product(assembled(system), system.pattern, v)
    np.testing.assert_allclose(found, exact, atol=1e-12 * float(jnp.abs(exact).max()))


def test_damping_at_row_level_is_m_plus_dt_dt_plus_beta_k():
    model, params, state = deformed()
    dt, beta = 1e-2, 5e-3
    params = params.replace(damping=jnp.asarray(beta))
    v = jnp.asarray(RNG.standard_normal(state.positions.shape)) * model.free[:, None]
    mass = nodal_mass(model, params.density)[:, None] * v

    def k_times(damping, step):
        system = system_of(model, params.replace(damping=jnp.asarray(damping)), state, step)
        return (product(assembled(system), system.pattern, v) - mass) / (step * (step + damping))

    stiffness = k_times(0.0, 1.0)
    np.testing.assert_allclose(k_times(beta, dt), stiffness, atol=1e-9 * float(jnp.abs(stiffness).max()))


@pytest.mark.parametrize("strain", STRAINS)
def test_matrix_is_symmetric_and_its_diagonal_blocks_are_known(strain):
    system = system_of(*deformed(cells=(2, 1, 1), strain=strain))
    matrix = assembled(system)
    u, v = vectors = RNG.standard_normal((2, *matrix.diagonal_blocks.shape[:2]))
    of_u, of_v = np.asarray(applied(matrix, vectors))
    np.testing.assert_allclose(np.vdot(u, of_v), np.vdot(v, of_u), rtol=1e-11)
    blocks = matrix.diagonal_blocks
    local = matrix.replace(factors=tuple(each.replace(shared=None) for each in matrix.factors))
    basis = np.eye(u.size).reshape(-1, *u.shape)
    dense = np.asarray(applied(local, basis)).reshape(*u.shape, *u.shape)
    exact = np.einsum("ninj->nij", dense)
    np.testing.assert_allclose(blocks, exact, atol=1e-12 * np.abs(exact).max())
    identity = np.einsum("nij,njk->nik", inverted(blocks), blocks)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=1e-12)


@pytest.mark.parametrize("strain", STRAINS)
@pytest.mark.parametrize("amount", [0.0, 0.003, 0.02])
def test_tangent_is_the_hessian_of_the_energy(amount, strain):
    """Also where 20 mm of noise on 15 mm cells turns elements inside out."""
    model, params, state = deformed(amount=amount, fixed=None, strain=strain)
    v = jnp.asarray(RNG.standard_normal(state.positions.shape))
    exact = hessian_of_energy(model, params, state.positions, v)
    found = product(tangent(model, params, state.positions), model.pattern, v)
    np.testing.assert_allclose(found, exact, atol=1e-9 * float(jnp.abs(exact).max()))


@pytest.mark.parametrize("strain", STRAINS)
def test_materials_by_element_are_averaged_over_each_domain(strain):
    """One value, one a body and the same value an element are one material; uneven ones keep the total stiffness."""
    model, params, state = deformed(strain=strain)
    elements = model.elements.count
    spread = params.replace(
        young=jnp.full(elements, params.young), damping=jnp.full(elements, params.damping), poisson=params.poisson[None]
    )
    for a, b in zip(system_of(model, params, state).elastic, system_of(model, spread, state).elastic, strict=True):
        np.testing.assert_allclose(a.compliance, b.compliance, rtol=1e-12)
        np.testing.assert_allclose(a.bias, b.bias, rtol=1e-12, atol=1e-15)
    uneven = params.replace(young=jnp.asarray(RNG.uniform(1e5, 1e6, elements)))
    dt, beta = 1e-2, params.damping
    for rows in system_of(model, uneven, state).elastic:
        total = jnp.sum(1 / rows.compliance[-1]) / (dt * (dt + beta))
        shear = 1 / (1 + params.poisson)
        local, shared = bulk_shares(1 / (1 - 2 * params.poisson), shear)
        kinds = {"local_volumetric": local, "shared_volumetric": shared, "volumetric": local + shared}
        per_young = kinds.get(rows.domains.part, shear)
        np.testing.assert_allclose(total, jnp.sum(uneven.young * model.elements.volumes) * per_young, rtol=1e-12)
