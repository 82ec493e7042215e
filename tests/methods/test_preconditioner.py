"""The two-level preconditioner: symmetric, worth its coarse space, steady as bodies turn; the solver's node order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.mesh.groups import bisected, body_groups
from jaxfem.methods.nodes.condensed import coarse_of, condensed_matrix, group_modes, solve_linear
from jaxfem.methods.nodes.preconditioner import coarse_inverse, two_level
from jaxfem.system.soft import step_system

RNG = np.random.default_rng(6)


def stiff_bar(dtype=None):
    build = {"dtype": dtype, "tolerance": 1e-6 if dtype is None else 1e-4}
    return scenes.beam((24, 2, 1), (2.4, 0.2, 0.1), young=1e9, damping=0.0, poisson=0.35, density=2200.0, build=build)


@jax.jit  # a program for all of it: one by one, its operations take many times as long to compile
def prepared(model, params, state):
    system = step_system(model, params, state, jnp.asarray(1 / 60, model.rest.dtype))
    return system, coarse_of(system)


solved = jax.jit(solve_linear)


def test_groups_partition_the_nodes_without_mixing_bodies():
    points = RNG.standard_normal((101, 3))
    bodies = np.repeat([0, 1, 2], [60, 40, 1])
    groups = body_groups(points, bodies, 12, 96)
    np.testing.assert_array_equal(np.sort(np.concatenate(groups)), np.arange(101))
    assert all(len(np.unique(bodies[g])) == 1 for g in groups)
    sizes = [len(g) for g in bisected(points, 8)]
    assert max(sizes) <= 2 * min(sizes)


def test_solver_order_is_a_permutation_with_padding():
    model, _, state = stiff_bar()
    pattern = model.pattern
    np.testing.assert_array_equal(pattern.scattered(pattern.gathered(state.positions)), state.positions)
    assert int(pattern.real.sum()) == model.nodes
    assert float(jnp.abs(pattern.gathered(state.positions)[pattern.real == 0]).sum()) == 0


def test_preconditioner_is_symmetric_and_positive():
    model, params, state = stiff_bar()
    system, coarse = prepared(model, params, state)

    @jax.jit
    def applied(*fields):
        apply = two_level(condensed_matrix(system), group_modes(system), coarse)
        return [apply(field) for field in fields]

    u, v = jnp.asarray(RNG.standard_normal((2, *model.pattern.order.shape, 3)))
    of_u, of_v = applied(u, v)
    np.testing.assert_allclose(jnp.vdot(u, of_v), jnp.vdot(v, of_u), rtol=1e-8)
    assert jnp.vdot(u, of_u) > 0


@pytest.mark.parametrize("dtype", [jnp.float32, None])
def test_coarse_space_saves_most_iterations(dtype):
    system, coarse = prepared(*stiff_bar(dtype))
    right = jnp.asarray(system.mass[:, None] * system.target * system.free[:, None])
    solution, info = solved(system, coarse, right)
    plain, slow = solved(system, jnp.zeros_like(coarse), right)
    assert (info.status, slow.status) == (0, 0)
    assert 5 * info.iterations < slow.iterations
    np.testing.assert_allclose(solution, plain, atol=(2e-2 if dtype else 1e-3) * float(jnp.abs(plain).max()))


def test_an_old_coarse_matrix_serves_a_turned_body():
    """Its frames turn with the groups: after a quarter turn the count of iterations hardly changes."""
    model, params, state = stiff_bar()
    fresh, coarse = prepared(model, params, state)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned, _ = prepared(model, params, state.replace(positions=state.positions @ turn.T))
    right = jnp.asarray(fresh.mass[:, None] * fresh.free[:, None] * RNG.standard_normal(fresh.target.shape))
    before = solved(fresh, coarse, right)[1].iterations
    after = solved(turned, coarse, right @ turn.T)[1].iterations
    assert abs(int(after) - int(before)) <= 2


@pytest.mark.slow
def test_groups_without_a_free_node_do_no_harm():
    mesh = jf.mesh.box((2.4, 0.2, 0.1), (24, 2, 1))
    body = jf.SoftBody(mesh, young=1e9, poisson=0.35, density=2200.0, fixed=mesh.points[:, 0] < 1.3)
    model, params, state = jf.build(jf.Scene([body]))
    _, info = jf.step(model, params, state, 1 / 60)
    assert info.status == 0


def test_failed_factorisation_leaves_the_coarse_space_out():
    system, _ = prepared(*stiff_bar())

    @jax.jit
    def inverse():
        matrix = condensed_matrix(system)
        return coarse_inverse(matrix.replace(blocks=-matrix.blocks), group_modes(system))

    assert float(jnp.abs(inverse()).max()) == 0.0


@pytest.mark.slow
def test_many_bodies_in_one_scene_move_as_each_alone():
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    bodies = [
        jf.SoftBody(mesh.translated((0, 0.1 * k, 0)), young=e, poisson=0.4, density=1000.0, fixed="x-")
        for k, e in enumerate((1e5, 3e5))
    ]
    together, _ = jf.rollout(*jf.build(jf.Scene(bodies), tolerance=1e-11), 1e-2, 10)
    for k, body in enumerate(bodies):
        alone, _ = jf.rollout(*jf.build(jf.Scene([body]), tolerance=1e-11), 1e-2, 10)
        own = slice(k * len(mesh.points), (k + 1) * len(mesh.points))
        np.testing.assert_allclose(together.positions[:, own], alone.positions, atol=1e-9)


@pytest.mark.slow
def test_a_prepared_model_gives_the_same_step():
    model, params, state = stiff_bar()
    ready = jf.prepare(model, params, state, 1 / 60)
    (plain, _), (fast, info) = (jf.step(m, params, state, 1 / 60) for m in (model, ready))
    assert info.status == 0
    np.testing.assert_allclose(fast.velocities, plain.velocities, atol=1e-12)
