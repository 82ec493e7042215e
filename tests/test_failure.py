"""Rollouts that end at the first bad step, or take it again in halves: values, lanes, derivatives, refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from derivatives import Parted

import jaxfem as jf
from jaxfem.solvers import Status

DT, STEPS, BAD = 1e-2, 6, 3


@pytest.fixture(scope="module")
def beam():
    return scenes.beam((2, 1, 1))


def forces(model, value):
    """Nodal forces of each step, those of step BAD (from 0) spoilt by `value`."""
    return jnp.zeros((STEPS, model.nodes, 3)).at[BAD, -1, 2].set(value)


def run(beam, value=jnp.nan, **options):
    model, params, state = beam
    return jf.rollout(model, params, state, DT, STEPS, forces=forces(model, value), **options)


def test_a_run_ends_at_its_first_bad_step(beam):
    (plain, _), (states, infos) = run(beam), run(beam, on_failure="stop")
    np.testing.assert_array_equal(infos.status != 0, np.arange(STEPS) >= BAD)
    np.testing.assert_allclose(states.positions[:BAD], plain.positions[:BAD], atol=1e-14)
    np.testing.assert_allclose(states.time, DT * np.minimum(np.arange(1, STEPS + 1), BAD + 1))
    assert (infos.iterations[BAD + 1 :] == 0).all() and (infos.iterations[:BAD] > 0).all()
    found = jf.diagnose(beam[0], beam[1], states, infos)
    assert found.step == BAD + 1 and "forces must be finite" in found.text


def test_a_run_without_failure_is_what_it_always_is(beam):
    (plain, told), (states, infos) = run(beam, 0.0), run(beam, 0.0, on_failure="stop")
    np.testing.assert_allclose(states.positions, plain.positions, atol=1e-14)
    assert jax.tree.structure(told) == jax.tree.structure(infos)
    np.testing.assert_array_equal(told.iterations, infos.iterations)


def test_a_bad_lane_ends_alone(beam):
    model, params, state = beam
    gravity = jnp.array([[0.0, 0.0, -9.81], [0.0, 0.0, jnp.nan], [0.0, 0.0, -3.0]])
    states, infos = jax.vmap(
        lambda g: jf.rollout(model, params.replace(gravity=g), state, DT, STEPS, on_failure="stop")
    )(gravity)
    np.testing.assert_array_equal((infos.status != 0).all(1), [False, True, False])
    alone = jf.rollout(model, params, state, DT, STEPS, on_failure="stop")[0]
    np.testing.assert_allclose(states.positions[0], alone.positions, atol=1e-9)


@pytest.mark.slow
def test_derivatives_before_the_end_are_those_of_a_sound_run(beam):
    """Forwards and backwards, though the step that ends the run has no finite value."""
    model, params, state = beam

    def tip(young, value, on_failure):
        pushed = forces(model, value)
        made = jf.rollout(model, params.replace(young=young), state, DT, STEPS, forces=pushed, on_failure=on_failure)
        return made[0].positions[BAD - 1, -1, 2]

    _, wanted = jax.jit(lambda young: jax.jvp(lambda e: tip(e, 0.0, "continue"), (young,), (1.0,)))(2.6e5)
    assert wanted != 0
    stopped = Parted(lambda young: tip(young, jnp.nan, "stop"))
    np.testing.assert_allclose(stopped.forwards(2.6e5, direction=(1.0,)), wanted, rtol=1e-5)
    np.testing.assert_allclose(*stopped.backwards(2.6e5), wanted, rtol=1e-5)


@pytest.fixture(scope="module")
def limited(beam):
    """The beam with an iteration less than its step needs, enough for its halves."""
    model, params, state = beam
    whole, half = (int(jf.step(model, params, state, dt)[1].iterations) for dt in (1e-3, 5e-4))
    assert half < whole
    return model.replace(max_iterations=jnp.int32(whole - 1)), params, state


def halved(limited, young=2.6e5, **options):
    model, params, state = limited
    return jf.rollout(model, params.replace(young=young), state, 1e-3, 1, on_failure="halve", **options)


def test_a_step_that_fails_is_taken_in_halves(limited):
    model, params, state = limited
    assert int(jf.step(model, params, state, 1e-3)[1].status) == int(Status.ITERATION_LIMIT)
    states, infos = halved(limited)
    assert int(infos.status[0]) == 0 and int(infos.substeps[0]) == 2
    for _ in range(2):
        state, info = jf.step(model, params, state, 5e-4)
    np.testing.assert_allclose(states.positions[0], state.positions, atol=1e-12)
    assert states.time[0] == pytest.approx(1e-3)
    assert int(infos.iterations[0]) > 2 * int(info.iterations)  # those of the step that failed count too
    hopeless = model.replace(max_iterations=jnp.int32(2)), params, limited[2]
    states, infos = halved(hopeless)
    assert int(infos.status[0]) == int(Status.ITERATION_LIMIT) and int(infos.substeps[0]) == 0
    assert states.time[0] == pytest.approx(1e-3 / 8)


@pytest.mark.slow
def test_derivatives_of_halves_are_those_of_half_steps(limited):
    model, params, start = limited

    @Parted
    def by_halves(young):
        return halved(limited, young)[0].positions[0, -1, 2]

    def by_steps(young):
        state = start
        for _ in range(2):
            state, _ = jf.step(model, params.replace(young=young), state, 5e-4)
        return state.positions[-1, 2]

    _, wanted = jax.jvp(by_steps, (2.6e5,), (1.0,))
    np.testing.assert_allclose(by_halves.forwards(2.6e5, direction=(1.0,)), wanted, rtol=1e-5)
    np.testing.assert_allclose(*by_halves.backwards(2.6e5), wanted, rtol=1e-5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"on_failure": "halt"}, "on_failure is 'halt'; give one of 'continue', 'stop', 'halve'"),
        ({"on_failure": "halve", "halvings": 0}, "halvings is 0; give a whole number from 1 to 10"),
        ({"on_failure": "halve", "halvings": 2.0}, "halvings is 2.0"),
    ],
)
def test_what_is_refused(beam, options, message):
    with pytest.raises(jf.StepError, match=message):
        run(beam, **options)
