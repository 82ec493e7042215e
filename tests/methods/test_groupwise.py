"""Groups of elements with one rotation each, against dense algebra, one another, and the row form."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.methods.assembled import stiffness_blocks
from jaxfem.methods.groupwise import Groupwise, binding_limit, interface_gap
from jaxfem.solvers import describe

DT = 4e-3
YOUNG, POISSON, DENSITY, BETA, ALPHA = 6e4, 0.3, 1070.0, 2e-3, 1.5


def built(method, cells=(4, 1, 1), dtype=None, **more):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells)
    values = dict(young=YOUNG, poisson=POISSON, density=DENSITY, damping=BETA, mass_damping=ALPHA, fixed="x-") | more
    body = jf.SoftBody(mesh, **values)
    return jf.build(jf.Scene([body]), solver=method, dtype=dtype, tolerance=1e-12 if dtype is None else None)


def dense_steps(model, steps):
    """Corotated FEM with one rotation for all of a body, in NumPy: dense stiffness, shape matching by SVD."""
    elements, rest = model.elements, np.asarray(model.rest)
    lam, mu = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
    blocks = np.asarray(stiffness_blocks(elements, elements.gradients.transpose(2, 0, 1), lam, mu))
    n, cells = len(rest), np.asarray(elements.cells)
    stiffness = np.zeros((n, 3, n, 3))
    for cell, block in zip(cells, blocks, strict=True):
        for a in range(4):
            for b in range(4):
                stiffness[cell[a], :, cell[b]] += block[a, b]
    mass = DENSITY * np.asarray(model.nodal_volumes)
    free = np.repeat(np.asarray(model.free) > 0, 3)
    x, v = rest.copy(), np.zeros_like(rest)
    for _ in range(steps):
        arms = [p - (mass[:, None] * p).sum(0) / mass.sum() for p in (x, rest)]
        u, _, vt = np.linalg.svd(np.einsum("n,ni,nj->ij", mass, *arms))
        turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
        turned = np.einsum("ij,njmk,lk->niml", turn, stiffness, turn).reshape(3 * n, 3 * n)
        force = turned @ (arms[0] - arms[1] @ turn.T).ravel()
        left = np.diag(np.repeat(mass * (1 + DT * ALPHA), 3)) + DT * (DT + BETA) * turned
        gravity = np.repeat(mass, 3) * np.tile([0, 0, -9.81], n)
        right = np.repeat(mass, 3) * v.ravel() + DT * (gravity - force)
        v = np.zeros(3 * n)
        v[free] = np.linalg.solve(left[np.ix_(free, free)], right[free])
        v = v.reshape(n, 3)
        x = x + DT * v
    return x


def test_one_group_is_corotated_fem_with_one_rotation():
    model, params, state = built(Groupwise(groups=1))
    states, info = jf.rollout(model, params, state, DT, 20)
    assert not info.status.any()
    expected = dense_steps(model, 20)
    assert np.abs(expected - np.asarray(model.rest)).max() > 5e-3
    np.testing.assert_allclose(states.positions[-1], expected, atol=1e-11, rtol=0)


def test_exact_ties_leave_no_gap_and_no_group_turns_the_whole_stiff():
    """Gaps below 1e-8 m; where all rotations are the identity, cuts change nothing at all."""
    four, _ = jf.rollout(*built(Groupwise(groups=4)), DT, 20)
    assert float(interface_gap(four).max()) < 1e-12
    first = [jf.step(*built(Groupwise(groups=groups)), dt=DT)[0].positions for groups in (1, 3, 4)]
    np.testing.assert_allclose(first[1], first[0], atol=1e-14)
    np.testing.assert_allclose(first[2], first[0], atol=1e-14)


def test_a_group_an_element_is_corotated_fem_element_by_element():
    """Shape matching of one element's corners is not the polar factor of F, but near it for small strains."""
    model, params, state = built(Groupwise(size=1), cells=(3, 1, 1), young=2e5)
    assert model.plan.count == model.elements.count
    states, _ = jf.rollout(model, params, state, DT, 20)
    expected, _ = jf.rollout(*built("assembled", cells=(3, 1, 1), young=2e5), DT, 20)
    way = np.abs(np.asarray(expected.positions[-1] - model.rest)).max()
    np.testing.assert_allclose(states.positions[-1], expected.positions[-1], atol=0.02 * way)
    assert float(interface_gap(states).max()) < 1e-10


def test_a_preconditioner_that_is_out_of_date_changes_no_solution():
    model, params, state = built(Groupwise(groups=3))
    stale = jf.prepare(model, params.replace(young=YOUNG / 3), state, 2 * DT)
    (one, told), (two, other) = jf.step(stale, params, state, dt=DT), jf.step(model, params, state, dt=DT)
    assert int(told.status) == int(other.status) == 0 and int(told.iterations) > int(other.iterations)
    np.testing.assert_allclose(one.positions, two.positions, atol=1e-12)


@pytest.mark.slow
def test_the_binding_iteration_goes_to_the_exact_one():
    model, params, state = built(Groupwise(groups=3))
    k = float(binding_limit(model, params, state, DT)) / 2
    exact, _ = jf.rollout(model, params, state, DT, 5)
    off, gaps = [], []
    for rounds in (10, 100):
        states, info = jf.rollout(*built(Groupwise(groups=3, binding=k, rounds=rounds)), DT, 5)
        assert not info.status.any()
        off.append(float(jnp.abs(states.positions - exact.positions).max()))
        gaps.append(float(interface_gap(states).max()))
    assert off[1] < 0.3 * off[0] and gaps[1] < 0.3 * gaps[0]


@pytest.mark.slow
def test_the_limit_of_the_coefficient_is_enforced_or_told():
    """A little above 2 over the true largest eigenvalue it diverges; the computed limit is below that, not far."""
    model, params, state = built(Groupwise(groups=3))
    limit = float(binding_limit(model, params, state, DT))
    gap = {}
    for factor in (0.95, 2.5):
        for enforce in (True, False):
            method = Groupwise(groups=3, binding=factor * limit, rounds=60, enforce=enforce)
            following, info = jf.step(*built(method), dt=DT)
            gap[factor, enforce] = float(interface_gap(following))
            if factor > 1 and not enforce:
                assert "above its stability limit" in describe(info.status)
            else:
                assert int(info.status) == 0
    assert gap[0.95, True] == gap[0.95, False] and gap[2.5, True] < 1.1 * gap[0.95, True]
    assert not gap[2.5, False] < 1e3 * gap[0.95, False]


def test_single_precision():
    single, info = jf.rollout(*built(Groupwise(groups=3), dtype=jnp.float32), DT, 20)
    double, _ = jf.rollout(*built(Groupwise(groups=3)), DT, 20)
    assert single.positions.dtype == jnp.float32 and not info.status.any()
    np.testing.assert_allclose(single.positions, double.positions, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("binding", ["exact", 20.0])
def test_derivatives_and_lanes(binding):
    model, params, state = built(Groupwise(groups=3, binding=binding, rounds=4))
    values = (1.0, POISSON, 1.0, 1.0, ALPHA) + (() if binding == "exact" else (1.0,))

    def tip(young, poisson, density, damping, alpha, k=1.0):
        given = dict(young=young * YOUNG, poisson=poisson, density=density * DENSITY)
        given |= dict(damping=damping * BETA, mass_damping=alpha)
        given |= {} if binding == "exact" else dict(binding=k * binding)
        return 10 * jf.rollout(model, params.replace(**given), state, DT, 3)[0].velocities[-1, -1, 2]

    run = check(tip, values)
    lanes = [each * np.array(values) for each in (0.8, 1.3)]
    both = jax.jit(jax.vmap(tip))(*np.stack(lanes, 1))
    np.testing.assert_allclose(both, [run(*each) for each in lanes], rtol=1e-9)


@pytest.mark.slow
def test_a_driven_end_and_two_bodies():
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    values = dict(young=YOUNG, poisson=POISSON, density=DENSITY)
    driven = [jf.Driven("x-", jf.Motion(velocity=(0.0, 0.05, 0.0)))]
    bodies = [
        jf.SoftBody(mesh, driven=driven, **values),
        jf.SoftBody(mesh.translated((0, 0, 0.1)), fixed="x-", **values),
    ]
    model, params, state = jf.build(jf.Scene(bodies), solver=Groupwise(groups=2))
    assert model.plan.count == 4
    states, info = jf.rollout(model, params, state, DT, 5)
    assert not info.status.any()
    moved = states.positions[-1] - model.rest
    left = np.flatnonzero(np.asarray(model.rest[:, 0]) < 1e-9)
    np.testing.assert_allclose(moved[left[:4], 1], 0.05 * 5 * DT, rtol=1e-9)
    bound, _ = jf.rollout(*jf.build(jf.Scene(bodies), solver=Groupwise(groups=2, binding=30.0, rounds=100)), DT, 5)
    np.testing.assert_allclose(bound.positions, states.positions, atol=2e-4)


@pytest.mark.parametrize(
    "settings, words",
    [
        (dict(groups=0), "groups = 0"),
        (dict(groups=None), "groups = None"),
        (dict(groups=10_000), "ask for fewer"),
        (dict(binding="loose"), "binding = 'loose'"),
        (dict(binding=-1.0), "at least 0 N/m"),
        (dict(size=2.5), "size = 2.5"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, words):
    with pytest.raises(jf.SceneError, match=f'"groupwise" .*{words}'):
        built(Groupwise(**settings))


def test_parts_that_move_by_themselves_share_no_rotation():
    """A part that falls past one that is held stays undeformed; one group of both would turn with them."""
    held, free = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1)), jf.mesh.box((0.03, 0.03, 0.03), 1, origin=(0.13, 0, 0))
    cells = np.concatenate([held.cells, free.cells + len(held.points)])
    mesh = jf.TetMesh(np.concatenate([held.points, free.points]), cells)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of separate parts
        body = jf.SoftBody(mesh, young=YOUNG, poisson=POISSON, density=DENSITY, fixed=mesh.points[:, 0] < 1e-9)
        with pytest.raises(jf.SceneError, match="2 separate parts"):
            jf.build(jf.Scene([body]), solver=Groupwise(groups=1))
        model, params, state = jf.build(jf.Scene([body]), solver=Groupwise(size=12), tolerance=1e-12)
    assert model.plan.count == 2
    states, info = jf.rollout(model, params, state, DT, 20)
    assert not info.status.any()
    fallen = np.asarray(states.positions[-1] - model.rest)[len(held.points) :]
    np.testing.assert_allclose(fallen, np.broadcast_to([0, 0, -9.81 * DT**2 * 210], fallen.shape), atol=1e-12)


def test_a_binding_that_does_not_hold_is_told():
    """k = 0 ties nothing; rounds too few for so long a step leave copies of a node metres apart."""
    with pytest.warns(jf.AccuracyWarning, match="binding = 0 N/m ties no groups"):
        built(Groupwise(groups=3, binding=0.0, rounds=4))
    state, info = jf.step(*built(Groupwise(groups=3, binding=20.0, rounds=4)), dt=100.0)
    assert float(interface_gap(state)) > 1 and "the groups came apart" in describe(info.status)
