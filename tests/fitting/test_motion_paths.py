"""Prescribed motions, places and turns at the start, by path: read, put and found from recordings."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import Recording, Search, Take, attach, fit_takes
from jaxfem.fitting.markers import marker_places
from jaxfem.fitting.moduli import asked_of
from jaxfem.fitting.paths import placed_constants, value_of, with_all
from jaxfem.materials.linear import Linear

SHAKEN = jf.Motion(amplitude=(0.0, 0.0, 2e-3), frequency=4.0, phase=0.3)
PLACES = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "base": (0.0, 0.015, 0.015)}


def shaken(motion=SHAKEN, dtype="float64"):
    """A beam on a table that shakes, beside a paddle that turns and a free ball."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    beam = jf.SoftBody(mesh, 4e5, 0.3, 1000.0, damping=2e-3, driven=[jf.Driven("x-", motion)], name="beam")
    turning = jf.Motion(angular_velocity=(0, 0, 2.0), center=(1.0, 0, 0))
    paddle = jf.RigidBody(jf.Box((0.1, 0.02, 0.02)), mass=1.0, position=(1.1, 0, 0), motion=turning, name="paddle")
    ball = jf.RigidBody(jf.Sphere(0.05), mass=0.1, position=(2.0, 0, 0.5), name="ball")
    return jf.build(jf.Scene([beam, paddle, ball]), dtype=dtype)


WANTED = {
    "motion.0.amplitude.z": (2e-3, "m"),
    "motion.0.frequency": (4.0, "Hz"),
    "motion.0.phase": (0.3, "rad"),
    "motion.0.velocity.x": (0.0, "m/s"),
    "motion.paddle.angular_velocity.z": (2.0, "rad/s"),
    "motion.paddle.center.x": (1.0, "m"),
    "place.ball.z": (0.5, "m"),
    "turn.ball.x": (0.0, "rad"),
}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_motions_and_places_are_read_and_put(dtype):
    model, params, state = shaken(dtype=dtype)
    known = placed_constants(model, params, state)
    for name, (value, unit) in WANTED.items():
        assert known[name].unit == unit and value_of(known[name], params, state) == pytest.approx(value, rel=1e-6), name
        changed = with_all(params, state, {name: jnp.asarray(0.25, dtype)}, (known[name],))
        if not name.startswith("turn"):
            assert value_of(known[name], *changed) == pytest.approx(0.25), name
    assert "place.beam.x" not in known and "place.paddle.x" not in known  # both are held
    moved, _ = with_all(
        params, state, {"motion.paddle.center.x": jnp.asarray(0.5, dtype)}, (known["motion.paddle.center.x"],)
    )
    assert np.allclose(moved.rigid.motions[0].center, (0.5, 0, 0)) and moved.rigid.motions[0].center.dtype == dtype
    _, turned = with_all(params, state, {"turn.ball.z": jnp.asarray(np.pi / 2, dtype)}, (known["turn.ball.z"],))
    number = model.rigid.names.index("ball")
    assert np.allclose(turned.rigid.orientations[number], (np.sqrt(0.5), 0, 0, np.sqrt(0.5)), atol=1e-6)


def test_both_moduli_are_known_where_stiffness_is_made_of_young_and_poisson():
    _, params, _ = shaken()
    assert asked_of(Linear(1e5, 0.3), params) == {"young", "poisson"}

    class BothAndMore(jf.Material, word="both_and_more"):
        """A law whose stiffness has a constant more."""

        constants = (*Linear.constants[:2], jf.materials.constants.DENSITY)

        def stiffness(self, values):
            return values["young"] * values["density"], values["poisson"]

    assert asked_of(BothAndMore(young=1e5, poisson=0.3, density=1.0), params) == {"young", "poisson", "density"}


@pytest.mark.slow
def test_amplitude_and_frequency_of_a_shaken_table_come_back():
    model, params, state = shaken()
    markers = attach(model, PLACES)
    states, infos = jf.rollout(model, params, state, 1e-2, 40)
    assert not np.asarray(infos.status).any()
    clean = np.concatenate([np.asarray(marker_places(markers, state))[None], marker_places(markers, states)])
    noisy = clean + 2e-5 * np.random.default_rng(0).normal(size=clean.shape)
    recording = Recording(1e-2 * np.arange(41), noisy, tuple(PLACES))
    take = Take(model, params, state, recording, PLACES, 1e-2, compare="position", release=0.0)
    start = {"motion.0.amplitude.z": 1e-3, "motion.0.frequency": 3.8, "young": 3e5}
    search = Search(candidates=1, polish=15, tol=1e-6)
    result = fit_takes([take], parameters=list(start), starts=[start], search=search)
    for name, true in (("motion.0.amplitude.z", 2e-3), ("motion.0.frequency", 4.0), ("young", 4e5)):
        assert result.values[name] == pytest.approx(true, rel=0.02), result.summary()
