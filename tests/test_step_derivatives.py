"""Derivatives of steps and rollouts: against differences, of second order, at nasty points, unconverged ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from derivatives import Parted

import jaxfem as jf
from jaxfem.methods.ending import inverted_elements

RNG = np.random.default_rng(3)

GROUPS = ["young", "poisson", "damping", "density", "gravity", "positions", "velocities"]


@pytest.fixture(scope="module")
def rollout_loss():
    model, params, state = scenes.beam((3, 1, 1), build={"tolerance": 1e-13})
    state = state.replace(
        velocities=jnp.asarray(0.1 * RNG.standard_normal(state.velocities.shape)) * model.free[:, None]
    )
    target = state.positions + 0.004

    def loss(values):
        own = {k: values[k] for k in GROUPS[:5]}
        start = state.replace(positions=values["positions"], velocities=values["velocities"])
        states, _ = jf.rollout(model, params.replace(**own), start, 1e-2, 50)
        return jnp.sum((states.positions[::5] - target) ** 2) * 1e4

    values = {k: getattr(params, k) for k in GROUPS[:5]}
    values |= {"positions": state.positions, "velocities": state.velocities}
    return Parted(loss), values


@pytest.fixture(scope="module")
def directions(rollout_loss):
    _, values = rollout_loss
    return {k: RNG.standard_normal(np.shape(v)) * np.maximum(np.abs(v).mean(), 1e-3) for k, v in values.items()}


@pytest.mark.parametrize("group", GROUPS)
def test_gradient_of_fifty_steps(rollout_loss, directions, group):
    """jvp = vjp = central differences (Richardson-extrapolated) to 1e-6, in every float a rollout depends on."""
    loss, values = rollout_loss
    direction = directions[group]
    only = {k: jnp.asarray(direction if k == group else np.zeros(np.shape(v))) for k, v in values.items()}
    forward, (gradient,) = loss.forwards(values, direction=(only,)), loss.backwards(values)
    backward = float(jnp.vdot(gradient[group], direction))

    def difference(h):
        ends = [loss({**values, group: values[group] + s * h * direction}) for s in (1, -1)]
        return float(ends[0] - ends[1]) / (2 * h)

    h = 2e-4
    central = (4 * difference(h / 2) - difference(h)) / 3
    np.testing.assert_allclose(backward, forward, rtol=1e-9)
    np.testing.assert_allclose(forward, central, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["condensed", "mprgp"])
def test_gradient_at_a_nasty_point(solver):
    """A step from a shape with an element turned inside out: derivatives exist, are finite and equal differences."""
    model, params, state = scenes.beam((2, 1, 1), build={"tolerance": 1e-13, "solver": solver})
    tip = int(jnp.argmax(state.positions @ jnp.ones(3)))
    bad = state.positions.at[tip].add(jnp.array([-0.08, -0.01, -0.005]))
    direction = jnp.asarray(RNG.standard_normal(bad.shape))

    @Parted
    def loss(s):
        after, _ = jf.step(model, params, state.replace(positions=bad + s * direction), 1e-3)
        return jnp.sum(after.velocities**2)

    assert inverted_elements(model, bad) > 0
    forward, (backward,) = loss.forwards(0.0, direction=(1.0,)), loss.backwards(0.0)
    central = (loss(1e-7) - loss(-1e-7)) / 2e-7
    np.testing.assert_allclose(forward, backward, rtol=1e-9)
    np.testing.assert_allclose(forward, central, rtol=1e-6)


@pytest.mark.slow
def test_second_derivative_of_a_step():
    model, params, state = scenes.beam((2, 1, 1), build={"tolerance": 1e-13})
    start = jf.step(model, params, state, 1e-2)[0]

    def loss(log_young):
        after, _ = jf.step(model, params.replace(young=jnp.exp(log_young)), start, 1e-2)
        return jnp.sum((after.positions - model.rest) ** 2) * 1e6

    x, h = jnp.log(params.young), 1e-4
    both = jax.jit(lambda x: jax.jvp(jax.grad(loss), (x,), (jnp.ones(()),)))  # the gradient and its derivative
    central = (both(x + h)[0] - both(x - h)[0]) / (2 * h)
    np.testing.assert_allclose(both(x)[1], central, rtol=1e-6)


@pytest.mark.slow
def test_reverse_over_reverse_through_a_rollout():
    """Where JAX drops custom rules: the step's derivative is a primitive linear solve and survives nested scans."""
    model, params, state = scenes.beam((1, 1, 1), build={"tolerance": 1e-13})

    def loss(log_young):
        states, _ = jf.rollout(model, params.replace(young=jnp.exp(log_young)), state, 1e-2, 3)
        return jnp.sum((states.positions[-1] - model.rest) ** 2) * 1e6

    x, h = jnp.log(params.young), 1e-4
    both = jax.jit(jax.value_and_grad(jax.grad(loss)))
    central = (both(x + h)[0] - both(x - h)[0]) / (2 * h)
    np.testing.assert_allclose(both(x)[1], central, rtol=1e-6)


@pytest.mark.slow
def test_a_derivative_that_did_not_converge_is_nan():
    model, params, state = scenes.beam((2, 1, 1), build={"tolerance": 1e-12})
    rest, _ = jf.equilibrium(model, params, state)
    stingy = model.replace(max_iterations=jnp.int32(2))

    def sag(young, which):
        return jf.equilibrium(which, params.replace(young=young), rest)[0].positions[-1, 2]

    assert np.isfinite(jax.grad(sag)(params.young, model))
    assert np.isnan(jax.grad(sag)(params.young, stingy))
