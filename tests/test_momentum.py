"""Free bodies keep linear and angular momentum to rounding: at any tolerance, any strain, in each method."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import Parted

import jaxfem as jf
from jaxfem.model import nodal_mass

DT = 1 / 60


def cube(corner=(0.0, 0.0, 0.0), **changes):
    """A soft cube of a decimetre, twelve elements."""
    mesh = jf.mesh.box((0.1, 0.1, 0.1), (1, 1, 1), origin=corner)
    return jf.SoftBody(mesh, **{"young": 1e5, "poisson": 0.3, "density": 1000.0, "damping": 2e-3, **changes})


def momenta(model, params, states):
    """Linear momentum (T, 3), angular momentum about the origin (T, 3), and sum m |x| |v| at its largest."""
    mass = np.asarray(nodal_mass(model, params.density))[:, None]
    x, p = np.asarray(states.positions), mass * np.asarray(states.velocities)
    size = np.sum(np.linalg.norm(x, axis=-1) * np.linalg.norm(p, axis=-1), -1)
    return p.sum(1), np.cross(x, p).sum(1), size.max()


def run(scene, state_of=None, steps=30, **choices):
    """Momenta along a run, the first after one step, and its infos."""
    model, params, state = jf.build(scene, **choices)
    state = state if state_of is None else state_of(state)
    states, infos = jf.rollout(model, params, state, DT, steps)
    assert not infos.status.any()
    first = jax.tree.map(lambda leaf: leaf[None], state)
    return momenta(model, params, first), momenta(model, params, states), infos


def flattened(state):
    """Pressed flat, and a little out of true."""
    noise = np.random.default_rng(0).uniform(-1e-3, 1e-3, state.positions.shape)
    return state.replace(positions=state.positions * jnp.array([1, 1, 0.0]) + noise)


def spinning(state):
    """Thrown, and turning at 10 rad/s."""
    centre = state.positions.mean(0)
    return state.replace(
        velocities=jnp.array([1.0, -2, 3]) + jnp.cross(jnp.array([6.0, 8, 0]), state.positions - centre)
    )


@pytest.mark.parametrize("start", [flattened, spinning])
@pytest.mark.parametrize("method", ["condensed", "mprgp"])
def test_a_free_body_keeps_its_momentum_whatever_the_tolerance(start, method):
    before, after, infos = run(jf.Scene([cube()], gravity=(0, 0, 0)), start, solver=method, tolerance=1e-2)
    scale = max(after[2], before[2])
    np.testing.assert_allclose(after[1], np.broadcast_to(before[1], after[1].shape), atol=1e-12 * scale)
    np.testing.assert_allclose(after[0], np.broadcast_to(before[0], after[0].shape), atol=1e-12 * scale / 0.1)
    assert infos.spin_loss.max() < 1e-12


@pytest.mark.parametrize(
    "method", ["condensed", pytest.param("mprgp", marks=pytest.mark.slow), pytest.param("pgs", marks=pytest.mark.slow)]
)
def test_bodies_that_strike_each_other_keep_what_they_have_together(method):
    pair = [cube(velocity=(0.0, 0.0, 2.0), name="low"), cube((0.03, 0.02, 0.12), name="high")]
    contacts = [jf.Contact(*pair, friction=0.0), jf.Contact(pair[0], jf.Plane((0, 0, -9.0), (0, 0, 1)))]
    scene = jf.Scene(pair, gravity=(0, 0, 0), contacts=contacts)
    before, after, infos = run(scene, solver=method, tolerance=1e-3)
    assert np.abs(after[0][-1] - before[0][0]).max() < 1e-12 * after[2] / 0.1
    # Contacts push at the foot of a node on a face, along the face's normal even a little aside of the face.
    assert np.abs(after[1][-1] - before[1][0]).max() < 1e-3 * after[2]
    assert infos.spin_loss.max() > 1e-4  # each of them alone is turned by the other


def test_bodies_that_a_joint_ties_keep_what_they_have_together():
    pair = [cube(name="one"), cube((0.1, 0.1, 0.1), name="other")]
    scene = jf.Scene(pair, gravity=(0, 0, 0), joints=[jf.BallJoint(*pair, (0.1, 0.1, 0.1))])
    before, after, _ = run(scene, spinning, tolerance=1e-4)
    assert np.abs(after[0][-1] - before[0][0]).max() < 1e-12 * after[2] / 0.1
    assert np.abs(after[1][-1] - before[1][0]).max() < 1e-6 * after[2]  # a joint's points are a little apart


def test_the_loss_of_a_scheme_that_keeps_it_not_is_told():
    model, params, state = jf.build(jf.Scene([cube()], gravity=(0, 0, 0)), scheme="generalized_alpha", tolerance=1e-11)
    state = spinning(state)
    mass = np.asarray(nodal_mass(model, params.density))[:, None]

    def spin(state):
        arm, own = (np.asarray(v) - (mass * v).sum(0) / mass.sum() for v in (state.positions, state.velocities))
        momentum = mass * own
        size = np.sum(np.linalg.norm(arm, axis=1) * np.linalg.norm(momentum, axis=1))
        return np.cross(arm, momentum).sum(0), size

    for _ in range(3):
        following, info = jf.step(model, params, state, DT)
        (before, low), (after, high) = spin(state), spin(following)
        wanted = np.linalg.norm(after - before) / max(low, high)
        assert wanted > 1e-5
        assert float(info.spin_loss) == pytest.approx(wanted, rel=1e-6)
        state = following


def test_what_is_held_has_no_loss_and_no_program_for_it():
    model, params, state = jf.build(jf.Scene([cube(fixed="z-")]))
    assert model.drifting is None and jf.step(model, params, state, DT)[1].spin_loss is None


def test_derivatives_pass_through_the_correction():
    model, params, state = jf.build(jf.Scene([cube()], gravity=(0, 0, 0)), tolerance=1e-12)
    state = spinning(flattened(state))
    weights = jnp.arange(state.positions.size).reshape(state.positions.shape) ** 2.0

    @Parted
    def end(young):
        found, _ = jf.step(model, params.replace(young=young), state, DT)
        return jnp.sum(found.velocities * weights)

    young, step = 1e5, 1e2
    wanted = (end(young + step) - end(young - step)) / (2 * step)
    assert float(*end.backwards(young)) == pytest.approx(float(wanted), rel=1e-5)
    assert float(end.forwards(young, direction=(1.0,))) == pytest.approx(float(wanted), rel=1e-5)


def test_derivatives_pass_through_the_places_that_it_corrects():
    """A deformed body that turns: its second step's correction is about places that the first one led to."""
    model, params, state = jf.build(jf.Scene([cube()], gravity=(0, 0, 0)), tolerance=1e-12)
    state = spinning(flattened(state))
    weights = jnp.arange(state.positions.size).reshape(state.positions.shape) ** 2.0

    @Parted
    def end(scale):
        states, _ = jf.rollout(model, params, state.replace(velocities=scale * state.velocities), 5e-3, 3)
        return jnp.sum(states.positions[-1] * weights)

    step = 1e-4
    wanted = (end(1 + step) - end(1 - step)) / (2 * step)
    assert float(*end.backwards(1.0)) == pytest.approx(float(wanted), rel=1e-6)
    assert float(end.forwards(1.0, direction=(1.0,))) == pytest.approx(float(wanted), rel=1e-6)


@pytest.mark.parametrize(("speed", "most"), [(2.0, 1.002), (5.0, 1.01)])
def test_a_spin_stores_no_energy(speed, most):
    """Rotations of the start of a step take a turn's chord for its arc: 1.09 at 5 rad/s after 400 steps."""
    model, params, state = jf.build(jf.Scene([cube(damping=0.0)], gravity=(0, 0, 0)))
    axis = jnp.array([0.3, 0.5, 0.8]) / np.sqrt(0.98) * speed
    state = state.replace(velocities=jnp.cross(axis, state.positions - state.positions.mean(0)))
    states, infos = jf.rollout(model, params, state, DT, 200, every=200)
    assert not infos.status.any()
    first, last = (jf.energies(model, params, each) for each in (state, jax.tree.map(lambda leaf: leaf[-1], states)))
    ratio = float((last.kinetic + last.elastic) / (first.kinetic + first.elastic))
    assert 0.99 < ratio < most


def test_a_body_that_turns_too_far_in_a_step_is_named():
    """At a third of a radian a step energy grows by a tenth and more; a body that is held may turn as it is driven."""
    model, params, state = jf.build(jf.Scene([cube(damping=0.0, name="top")], gravity=(0, 0, 0)))

    def after(speed):
        turning = jnp.cross(speed * jnp.array([0.6, 0.0, 0.8]), state.positions - state.positions.mean(0))
        return jf.step(model, params, state.replace(velocities=turning), DT)[1].status

    assert int(after(5.0)) == 0
    told = jf.solvers.describe(after(20.0))
    assert "turned too far" in told and '"top"' in told and "smaller time step" in told
