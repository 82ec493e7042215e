"""Mass-proportional damping in the row form: what it does to free bodies, masses, schemes, energies, files and fits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.io.scene_files import load_scene

DT, STEPS, ALPHA = 1e-2, 10, 3.0


def flying(mass_damping=ALPHA, gravity=(0.0, 0.0, 0.0), **build):
    body = jf.SoftBody(
        jf.mesh.box((0.1, 0.05, 0.05), 1),
        young=1e5,
        poisson=0.3,
        density=1e3,
        velocity=(1.0, 2.0, 0.0),
        mass_damping=mass_damping,
    )
    return jf.build(jf.Scene([body], gravity=gravity), **build)


@pytest.mark.parametrize("mass", ["lumped", "consistent"])
@pytest.mark.parametrize("solver", ["condensed", "mprgp"])
def test_a_free_body_loses_speed_at_the_rate_alpha(mass, solver):
    if (mass, solver) == ("consistent", "mprgp"):
        pytest.skip("that method takes lumped masses")
    states, info = jf.rollout(*flying(mass=mass, solver=solver), DT, STEPS)
    assert not info.status.any()
    expected = np.array([1.0, 2.0, 0.0]) * (1 + DT * ALPHA) ** -np.arange(1, STEPS + 1)[:, None]
    np.testing.assert_allclose(states.velocities.mean(1), expected, rtol=1e-9, atol=1e-9)


def test_second_order_schemes_take_it_to_second_order():
    """exp(-alpha t) itself, four times as near with half the step; also with consistent masses."""
    off = []
    for steps in (STEPS, 2 * STEPS):
        build = dict(scheme="generalized_alpha", mass="consistent")
        states, _ = jf.rollout(*flying(**build), 0.1 / steps, steps)
        off.append(abs(float(states.velocities[-1, :, 0].mean()) - np.exp(-ALPHA * 0.1)))
    assert off[1] < off[0] / 3.5 and off[1] < 1e-4


def test_it_falls_at_its_terminal_speed():
    states, _ = jf.rollout(*flying(mass_damping=200.0, gravity=(0, 0, -9.81)), DT, STEPS)
    np.testing.assert_allclose(states.velocities[-1, :, 2], -9.81 / 200, rtol=1e-4)


def test_the_account_books_what_it_takes():
    model, params, state = flying(gravity=(0, 0, -9.81))
    state = jf.with_account(model, params, state)
    start = sum(jf.energies(model, params, state).kinds.values())
    states, _ = jf.rollout(model, params, state, 1e-3, 20)
    end = jf.energies(model, params, jax.tree.map(lambda leaf: leaf[-1], states))
    lost = float(end.booked["drag"])
    assert lost > 0.01 * float(start)
    np.testing.assert_allclose(sum(end.kinds.values()), start, rtol=3e-3)


def test_scenes_without_it_know_no_such_constant():
    model, params, _ = flying(mass_damping=None)
    assert "mass_damping" not in params.constants and "mass_damping" not in model.constants
    assert flying()[0].constants["mass_damping"].unit == "1/s"


def test_derivatives():
    model, params, state = flying(gravity=(0, 0, -9.81))

    def place(alpha):
        return jf.rollout(model, params.replace(mass_damping=alpha), state, DT, STEPS)[0].positions[-1, 0, 0]

    check(place, (ALPHA,))


def test_bodies_with_and_without_it():
    mesh = jf.mesh.box((0.1, 0.05, 0.05), 1)
    values = dict(young=1e5, poisson=0.3, density=1e3, velocity=(1.0, 0.0, 0.0))
    two = [jf.SoftBody(mesh, mass_damping=2.0, **values), jf.SoftBody(mesh.translated((0, 1, 0)), **values)]
    model, params, state = jf.build(jf.Scene(two, gravity=(0, 0, 0)))
    np.testing.assert_allclose(params.mass_damping, [2.0, 0.0])
    states, _ = jf.rollout(model, params, state, DT, STEPS)
    half = len(mesh.points)
    np.testing.assert_allclose(states.velocities[-1, :half, 0], (1 + 2 * DT) ** -STEPS, rtol=1e-9)
    np.testing.assert_allclose(states.velocities[-1, half:, 0], 1.0, rtol=1e-9)


@pytest.mark.parametrize("value, words", [(-1.0, "must be >= 0"), ([1.0, 2.0], "one number"), (1e6, "plausible")])
def test_impossible_values_are_refused(value, words):
    with pytest.raises(jf.MaterialError, match=words):
        flying(mass_damping=value)


def test_scene_files_read_it(tmp_path):
    (tmp_path / "scene.toml").write_text(
        "[time]\nstep = 0.01\nsteps = 1\n[[body]]\nmesh = { box = [0.1, 0.1, 0.1], cells = 1 }\n"
        "young = 1e5\npoisson = 0.3\ndensity = 1e3\nmass_damping = 2.5\n"
    )
    file = load_scene(tmp_path / "scene.toml")
    assert "mass_damping" in [each.name for each in file.constants]
    assert jnp.isclose(file.build()[1].mass_damping, 2.5)
