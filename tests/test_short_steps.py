"""Single precision at steps of a microsecond: positions move by less than their last digit, and get there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

DT, STEPS = 1e-6, 2000
SOFT = {"young": 1e5, "poisson": 0.3, "density": 1e3, "damping": 2e-3}


def falling(kind):
    """A body a metre up, soft or rigid."""
    if kind == "rigid":
        return jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 1.0))
    return jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), (1, 1, 1), origin=(0, 0, 1.0)), **SOFT)


def fallen(kind, state_of=lambda state: state):
    """By how much it fell, of what it should have; and the time passed, of what it should be."""
    model, params, state = jf.build(jf.Scene([falling(kind)]), dtype=jnp.float32)
    states, infos = jf.rollout(model, params, state_of(state), DT, STEPS, every=STEPS)
    assert not infos.status.any()

    def height(state):
        places = state.rigid.positions if kind == "rigid" else state.positions
        return float(np.mean(np.asarray(places, np.float64)[..., 2]))

    way = 0.5 * 9.81 * DT**2 * STEPS * (STEPS + 1)
    return (height(state) - height(states)) / way, float(states.time[0]) / (DT * STEPS)


@pytest.mark.parametrize("kind", ["soft", "rigid"])
def test_a_fall_in_short_steps_loses_nothing(kind):
    way, time = fallen(kind)
    assert way == pytest.approx(1, abs=3e-3)  # the last digit of a metre, 6e-8, is 3e-3 of the 2e-5 fallen
    assert time == pytest.approx(1, abs=1e-6)


def test_without_the_carry_it_would():
    way, _ = fallen("soft", lambda state: state.replace(carry=None))
    assert way < 0.9


def test_double_precision_carries_nothing():
    _, _, state = jf.build(jf.Scene([falling("soft")]), dtype=jnp.float64)
    assert state.carry is None
    assert len(jax.tree.leaves(state)) < len(
        jax.tree.leaves(jf.build(jf.Scene([falling("soft")]), dtype=jnp.float32)[2])
    )


def shaken(offset, dtype, state_of=lambda state: state):
    """Velocities of a beam in twenty steps of its sag, `offset` metres away."""
    mesh = jf.mesh.box((0.3, 0.1, 0.1), (3, 1, 1)).translated((offset, 0, 1.0))
    body = jf.SoftBody(mesh, **SOFT, fixed=mesh.points[:, 0] < offset + 1e-6)
    model, params, state = jf.build(jf.Scene([body]), dtype=dtype)
    states, infos = jf.rollout(model, params, state_of(state), 0.01, 20)
    assert not infos.status.any()
    return np.asarray(states.velocities, float)


def test_strains_know_the_digits_that_positions_drop():
    """However far the origin: elements of a decimetre, a kilometre away, where the last digit is .06 mm."""
    exact = shaken(0.0, jnp.float64)

    def error(*given):
        return np.abs(shaken(*given) - exact).max() / np.abs(exact).max()

    assert error(0.0, jnp.float32) < 2e-5
    assert error(1000.0, jnp.float32) < 2e-5
    assert error(1000.0, jnp.float32, lambda state: state.replace(carry=None)) > 1e-3
