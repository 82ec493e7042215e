"""One step and many: against closed forms, across routes, lanes and precisions, and its derivatives."""

import json

import host
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.model import nodal_mass

RNG = np.random.default_rng(3)
FORCE_FREE = (0.0, 0.0, 0.0)


def single_mode(omega, solver):
    """A clamped block with one low mode, its Young's modulus set so that the mode has `omega` [rad/s]."""
    build = {"tolerance": 1e-13, "solver": solver}
    model, params, state = scenes.beam((2, 1, 1), gravity=FORCE_FREE, damping=0.0, build=build)
    (lowest,), (shape,) = host.frequencies(model, params, count=1)
    params = params.replace(young=params.young * (omega / lowest) ** 2)
    return model, params, state, jnp.asarray(shape), np.asarray(nodal_mass(model, params.density))[:, None]


@pytest.mark.parametrize("solver", ["condensed", pytest.param("mprgp", marks=pytest.mark.slow)])
def test_backward_euler_decays_as_its_closed_form(reference, solver):
    table = json.loads((reference / "implicit_euler_decay.json").read_text())["table"]
    model, params, state, shape, mass = single_mode(1.0, solver)
    if solver == "mprgp":
        table = [row for row in table if row["omega"] <= 100][::3]
    amplitude = 1e-8 / float(jnp.abs(shape).max())
    start = state.replace(positions=model.rest + amplitude * shape)
    for row in table:
        numerator, _, denominator = row["dt"].partition("/")
        dt = float(numerator) / float(denominator or 1)
        values = params.replace(young=params.young * row["omega"] ** 2, damping=jnp.asarray(row["beta"]))
        last = jax.tree.map(lambda leaf: leaf[-1], scenes.rolled(model, values, start, dt, 50)[0])
        x = float(jnp.sum(mass * shape * (last.positions - model.rest))) / amplitude
        v = float(jnp.sum(mass * shape * last.velocities)) / amplitude
        assert abs(x - row["x50"]) < 1e-6, row
        assert abs(v - row["v50"]) < 1e-6 * row["omega"], row


def test_routes_agree():
    results = {}
    for solver in ("condensed", "mprgp"):
        model, params, state = scenes.beam(build={"solver": solver, "tolerance": 1e-12})
        states, info = scenes.rolled(model, params, state, 1e-2, 20)
        assert (info.status == 0).all()
        results[solver] = states.positions
    np.testing.assert_allclose(results["condensed"], results["mprgp"], atol=1e-10)


@pytest.mark.parametrize("solver", ["condensed", pytest.param("mprgp", marks=pytest.mark.slow)])
def test_float32_follows_float64(solver):
    exact = scenes.beam(build={"tolerance": 1e-10})
    single = scenes.beam(build={"dtype": jnp.float32, "solver": solver})
    reference_run = scenes.rolled(*exact, 1e-2, 30)[0].positions
    states, info = scenes.rolled(*single, 1e-2, 30)
    assert states.positions.dtype == jnp.float32
    assert (info.status == 0).all()
    sag = float(jnp.abs(reference_run[-1] - exact[2].positions).max())
    assert jnp.abs(states.positions - reference_run).max() < 2e-3 * sag


def test_momentum_of_a_free_body_is_kept_to_rounding():
    model, params, state = scenes.beam(fixed=None, gravity=FORCE_FREE, build={"tolerance": 1e-14})
    velocities = jnp.asarray(RNG.standard_normal(state.velocities.shape))
    mass = nodal_mass(model, params.density)[:, None]
    states, _ = scenes.rolled(model, params, state.replace(velocities=velocities), 1e-3, 40)
    momentum = jnp.sum(mass * states.velocities, axis=1)
    size = jnp.sum(mass * jnp.abs(velocities))
    assert jnp.abs(momentum - jnp.sum(mass * velocities, 0)).max() < 1e-12 * size


def test_free_fall_is_exact_and_turned_bodies_stay_unstrained():
    model, params, state = scenes.beam(fixed=None)
    turned = state.replace(positions=state.positions @ scenes.random_rotation(5).T)
    states, _ = jf.rollout(model, params, turned, 1e-2, 10)
    drop = -9.81 * 1e-2**2 * 55
    np.testing.assert_allclose(
        states.positions[-1] - turned.positions, np.tile([0, 0, drop], (model.nodes, 1)), atol=1e-12
    )


def test_sixty_four_materials_at_once_equal_single_runs():
    model, params, state = scenes.beam((2, 1, 1), build={"tolerance": 1e-12})
    young = jnp.geomspace(1e4, 1e6, 64)

    def last(value):
        states, info = jf.rollout(model, params.replace(young=value), state, 1e-2, 10)
        return states.positions[-1], info.iterations

    together, counts = jax.jit(jax.vmap(last))(young)
    for lane in range(64):
        alone, count = last(young[lane])
        np.testing.assert_allclose(together[lane], alone, atol=1e-13)
        assert jnp.abs(counts[lane] - count).max() <= 1  # sums are ordered differently: rounding may cost a trip


def test_changing_numbers_compiles_nothing():
    from jaxfem.stepping.step import _step

    model, params, state = scenes.beam((2, 1, 2))
    jf.step(model, params, state, 1e-2)
    before = _step._cache_size()
    for change in (
        {"young": 1e4},
        {"poisson": 0.1},
        {"density": 5e3},
        {"damping": 0.1},
        {"gravity": np.ones(3, np.float32)},
    ):
        jf.step(model, params.replace(**change), state, 1e-2)
    jf.step(model, params, state.replace(time=3.0), 5e-3)
    other = scenes.beam((2, 1, 2), size=(1.0, 0.5, 0.5), young=1e7)
    jf.step(*other, 1e-3)
    assert _step._cache_size() == before


@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_a_step_never_leaves_the_device(strain):
    model, params, state = scenes.beam(strain=strain)
    assert "callback" not in str(jax.make_jaxpr(jf.step)(model, params, state, 1e-2))


@pytest.mark.slow
def test_rollout_saves_every_kth_state_and_checkpoints_agree():
    model, params, state = scenes.beam((2, 1, 1))
    everything, info = jf.rollout(model, params, state, 1e-2, 12)
    third, coarse = jf.rollout(model, params, state, 1e-2, 12, every=3, checkpoint=6)
    np.testing.assert_allclose(third.positions, everything.positions[2::3], atol=1e-15)
    np.testing.assert_array_equal(coarse.iterations, info.iterations.reshape(4, 3).max(1))

    def loss(young, checkpoint):
        states, _ = jf.rollout(model, params.replace(young=young), state, 1e-2, 12, checkpoint=checkpoint)
        return jnp.sum(states.positions[-1] ** 2)

    plain, saved = (jax.grad(loss)(params.young, c) for c in (None, 4))
    np.testing.assert_allclose(plain, saved, rtol=1e-9)


@pytest.mark.slow
def test_checkpointing_bounds_the_memory_of_a_long_gradient():
    """1000 steps of 144 elements, as the compiler counts: little more than each step's state, by blocks still less."""
    model, params, state = scenes.beam((6, 2, 2))

    def loss(young, checkpoint):
        states, _ = jf.rollout(
            model,
            params.replace(young=young),
            state,
            1e-2,
            1000,
            every=25 if checkpoint else 1000,
            checkpoint=checkpoint,
        )
        return jnp.sum(states.positions[-1] ** 2)

    def temporary(checkpoint):
        compiled = jax.jit(jax.grad(loss), static_argnums=1).lower(params.young, checkpoint).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    with_blocks, plain = temporary(25), temporary(None)
    state_bytes = 2 * 8 * 3 * model.nodes
    assert plain < 1.5 * 1000 * state_bytes  # not all that derivatives need
    assert with_blocks < 0.75 * plain


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda m, p, s: jf.step(m, p, s, 0.0), "dt is 0.0; give a positive time step"),
        (lambda m, p, s: jf.step(m, p, s, -1e-3), "dt is -0.001"),
        (lambda m, p, s: jf.step(m, p, s, float("nan")), "dt is nan"),
        (lambda m, p, s: jf.step(m, p, s.replace(positions=s.positions[1:]), 1e-2), "positions has shape"),
        (lambda m, p, s: jf.step(m, p, s, 1e-2, forces=jnp.zeros(3)), "forces has shape"),
        (lambda m, p, s: jf.rollout(m, p, s, 1e-2, 10, every=3), "must be a positive multiple of every"),
        (lambda m, p, s: jf.rollout(m, p, s, 1e-2, 0), "steps = 0"),
        (lambda m, p, s: jf.step(p, m, s, 1e-2), "the order is .model, params, state."),
        (lambda m, p, s: jf.step(m, s, p, 1e-2), "the order is .model, params, state."),
        (lambda m, p, s: jf.step(m, p.replace(young=np.ones(5)), s, 1e-2), r"young has shape \(5,\); give one number"),
        (lambda m, p, s: jf.equilibrium(m, p.replace(density=np.ones(8)), s), r"density has shape \(8,\)"),
        (lambda m, p, s: jf.step(m, p.replace(gravity=-9.81), s, 1e-2), r"gravity has shape \(\); give three numbers"),
        (lambda m, p, s: jf.step(m, p.replace(loads=(1.0,)), s, 1e-2), "params.loads holds 1 values"),
        (lambda m, p, s: jf.rollout(m, p, s, 1e-2, 10, checkpoint=3), "checkpoint = 3 must be"),
        (lambda m, p, s: jf.rollout(m, p, s, 1e-2, 4, forces=jnp.zeros((3, m.nodes, 3))), "3 rows for 4 steps"),
    ],
)
def test_impossible_calls_are_refused(call, text):
    with pytest.raises(jf.StepError, match=text):
        call(*scenes.beam((1, 1, 1)))


def test_trouble_becomes_a_status():
    model, params, state = scenes.beam((2, 1, 1), build={"max_iterations": 2, "tolerance": 1e-12})
    _, info = jf.step(model, params, state, 1e-2)
    assert info.status == jf.solvers.Status.ITERATION_LIMIT
    broken = state.replace(velocities=state.velocities.at[0, 0].set(jnp.nan).at[-1].set(jnp.nan))
    _, info = jf.step(model, params, broken, 1e-2)
    assert "state.velocities must be finite" in jf.solvers.describe(info.status)


def test_plain_numbers_and_lists_are_taken_as_arrays():
    model, params, state = scenes.beam((2, 1, 1))
    plain, _ = jf.step(model, params.replace(gravity=(0, 0, -1.62), young=2e5), state, 1e-2)
    lists = state.replace(positions=np.asarray(state.positions).tolist())
    same, _ = jf.step(model, params.replace(gravity=[0, 0, -1.62], young=2e5), lists, 1e-2)
    np.testing.assert_array_equal(plain.positions, same.positions)
    assert plain.velocities[-1, 2] < 0


@pytest.mark.slow
def test_gram_schmidt_steps_sag_like_polar_ones():
    sag = {}
    for kind in ("polar", "gram_schmidt"):
        model, params, state = scenes.beam((4, 1, 1), rotation=kind, damping=0.05)
        states, info = jf.rollout(model, params, state, 2e-2, 100, every=100)
        assert (info.status == 0).all()
        sag[kind] = float((states.positions[-1] - model.rest)[:, 2].min())
    np.testing.assert_allclose(sag["gram_schmidt"], sag["polar"], rtol=0.01)
