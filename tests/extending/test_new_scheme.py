"""A time scheme that this file alone defines: the implicit midpoint rule, second order and without damping."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.io import load_scene
from jaxfem.schemes import SCHEMES, Scheme, Stage, scheme_damping


class Midpoint(Scheme):
    """Strain and rate in the middle of the step: v_a = (v0 + v) / 2, x_a = x0 + dt / 2 v_a; x1 = x0 + dt v_a."""

    name: ClassVar[str] = "midpoint"
    order: ClassVar[int] = 2

    def stage(self, state, prescribed, free, dt):
        """Rows linearised where the old velocity leads in half a step."""
        old = state.velocities
        return Stage(
            base=state.positions + dt / 2 * old,
            ahead=jnp.where(free, -dt / 4 * old, dt / 4 * prescribed - dt / 2 * old),
            before=jnp.where(free, old / 2, prescribed / 2),
            start=old,
            reach=dt / 4,
            follow=0.5,
            weight=dt,
        )

    def advance(self, state, velocities, free, dt):
        """With the mean velocity; driven nodes with their own."""
        mean = 0.5 * (state.velocities + velocities)
        return state.positions + dt * jnp.where(free, mean, velocities), None

    def slope(self, turn):
        """z = (1 + i turn / 2) / (1 - i turn / 2)."""
        return 1j / (1 - 0.5j * turn)


SPAN = 0.08


def beam(scheme, damping=0.0):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    body = jf.SoftBody(mesh, young=2e5, poisson=0.3, density=1e3, damping=damping, fixed="x-")
    return jf.build(jf.Scene([body]), scheme=scheme, tolerance=1e-12)


def swing(scene, steps):
    """Positions after `SPAN`, in steps of a loop: every number of steps is the same program."""
    model, params, state = scene
    model = jf.prepare(model, params, state, SPAN / steps)
    for _ in range(steps):
        state, info = jf.step(model, params, state, SPAN / steps)
        assert info.status == 0
    return np.asarray(state.positions), state


@pytest.mark.slow
def test_it_is_of_second_order_and_keeps_energy():
    damped, counts = beam("midpoint", damping=2e-3), (32, 64, 128)
    exact = swing(damped, 1024)[0]
    errors = [np.abs(swing(damped, steps)[0] - exact).max() for steps in counts]
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(order - Midpoint.order) < 0.2, (order, errors)
    scene = beam("midpoint")
    model, params, _ = scene
    found, start = (jf.energies(model, params, each) for each in (swing(scene, 64)[1], scene[2]))
    total = [each.kinetic + each.elastic + each.gravity for each in (found, start)]
    assert abs(total[0] - total[1]) < 2e-3 * found.elastic
    # Backward Euler loses a good part of it in the same steps.
    lossy = jf.energies(*beam("backward_euler")[:2], swing(beam("backward_euler"), 64)[1])
    assert lossy.kinetic + lossy.elastic + lossy.gravity < total[1] - 20 * abs(total[0] - total[1])


def test_it_is_known_by_its_name_everywhere(tmp_path):
    assert SCHEMES["midpoint"].made is Midpoint
    assert float(scheme_damping("midpoint", 100.0, 1e-2)) == pytest.approx(0, abs=1e-12)
    file = tmp_path / "scene.toml"
    file.write_text(
        '[time]\nstep = 0.005\nsteps = 2\nscheme = "midpoint"\n'
        "[[body]]\nmesh = { box = [0.1, 0.03, 0.03], cells = 1 }\n"
        "young = 2e5\npoisson = 0.3\ndensity = 1000.0\nfixed = 'x-'\n"
    )
    assert isinstance(load_scene(file).build()[0].scheme, Midpoint)
    with pytest.raises(jf.SceneError, match=r"rho_inf = 0\.5 is no number of the scheme"):
        jf.build(jf.Scene([jf.RigidBody(jf.Sphere(1.0), mass=1.0)]), scheme="midpoint", rho_inf=0.5)
    with pytest.raises(jf.SceneError, match='scheme "midpoint" is for soft bodies'):
        jf.build(jf.Scene([jf.RigidBody(jf.Sphere(1.0), mass=1.0)]), scheme="midpoint")


@pytest.mark.slow
def test_derivatives_go_through_it():
    model, params, state = beam(Midpoint(), damping=1e-3)

    def place(young, speed):
        start = state.replace(velocities=speed * jnp.ones_like(state.velocities) * model.free[:, None])
        states, _ = jf.rollout(model, params.replace(young=young * params.young), start, 5e-3, 4)
        return jnp.sum(states.positions[-1, :, 2])

    check(place, (1.0, 0.1))


def test_sweeps_take_it_one_by_one_unless_it_knows_of_lanes():
    """Its `stage` and `advance` may look along the last axis, which is that of the variants with lanes last."""
    scene = beam("midpoint")
    options = {"outputs": {"x": "positions"}, "dt": 1e-2, "steps": 1}
    with pytest.raises(jf.sweeping.SweepError, match='takes schemes that know of lanes, not "midpoint"'):
        jf.sweep(*scene, {"young": np.array([1e5, 2e5])}, engine="lanes", **options)
    euler = SCHEMES["backward_euler"].made
    assert euler.lanes and not type("Own", (Midpoint,), {"advance": None}).lanes
    assert euler.euler and type("Named", (euler,), {}).euler and not type("Other", (euler,), {"advance": None}).euler
