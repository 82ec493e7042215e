"""Properties that hold for any mesh, material and state: rotation invariance, momentum, symmetry, no NaN in silence.

Shapes are fixed, so that all examples share a few programs; examples are the same in every run.
"""

import functools

import jax.numpy as jnp
import numpy as np
import scenes
from hypothesis import Phase, given, settings
from hypothesis import strategies as some

import jaxfem as jf
from jaxfem.solvers.status import describe

STEPS = 4
SIDE = 0.1
few = settings(max_examples=12, deadline=None, derandomize=True, database=None, phases=[Phase.generate])

seeds = some.integers(0, 2**31 - 1)
materials = some.fixed_dictionaries(
    {
        "young": some.floats(3, 9).map(lambda power: 10**power),
        "poisson": some.floats(-0.5, 0.45),
        "density": some.floats(0, 4).map(lambda power: 10**power),
        "damping": some.floats(0, 0.1),
    }
)
steps = some.floats(-4, 0).map(lambda power: 10**power)
NASTY = [0.0, -1.0, 1e-30, 1e30, -1e30, 1e200, np.inf, -np.inf, np.nan]


@functools.cache
def box_mesh():
    """A box of 2 x 2 x 2 cells of twelve tetrahedra, its own mirror image: 35 nodes."""
    return jf.mesh.box((SIDE,) * 3, 2, tets_per_cell=12, origin=(-SIDE / 2,) * 3)


def jittered(seed, amount):
    """The box with its nodes moved by up to a share of its side."""
    points = box_mesh().points + amount * SIDE * np.random.default_rng(seed).uniform(-1, 1, (35, 3))
    return jf.TetMesh(points, box_mesh().cells)


def soft(mesh, material, gravity=(0, 0, 0)):
    body = jf.SoftBody(mesh, **material)
    return jf.build(jf.Scene([body], gravity=gravity), tolerance=1e-12)


def started(model, state, seed, amount, dt):
    """Near its shape (far from it, for an `amount` of 1), and moving by a tenth of its side in a step."""
    speed = 0.1 * SIDE / dt
    random = np.random.default_rng(seed)
    places = np.asarray(model.rest) + amount * SIDE * random.uniform(-1, 1, model.rest.shape)
    return state.replace(positions=jnp.asarray(places), velocities=jnp.asarray(random.normal(0, speed, places.shape)))


def run(model, params, state, dt):
    states, infos = jf.rollout(model, params, state, dt, STEPS)
    return np.asarray(states.positions[-1]), np.asarray(states.velocities[-1]), np.asarray(infos.status)


@few
@given(seeds, materials, steps, some.floats(0, 0.3))
def test_what_is_turned_moves_turned(seed, material, dt, amount):
    """On any mesh: state and gravity turned, the same motion turned."""
    model, params, state = soft(jittered(seed, 0.05), material, (0.0, 0.0, -9.81))
    state = started(model, state, seed, amount, dt)
    turn = scenes.random_rotation(seed)
    places, speeds, status = run(model, params, state, dt)
    other = state.replace(positions=state.positions @ turn.T, velocities=state.velocities @ turn.T)
    turned, speeds_turned, again = run(model, params.replace(gravity=turn @ params.gravity), other, dt)
    assert (status == 0).all() and (again == 0).all()
    np.testing.assert_allclose(turned, places @ turn.T, atol=1e-6 * max(SIDE, np.abs(places).max()))
    np.testing.assert_allclose(speeds_turned, speeds @ turn.T, atol=1e-5 * max(SIDE / dt, np.abs(speeds).max()))


@few
@given(seeds, materials, steps, some.floats(0, 1))
def test_a_free_body_keeps_its_momentum(seed, material, dt, amount):
    """Its centre goes on as it did, from any start, collapsed and inverted elements included.

    Such a start may turn the body by more than a step of straight lines bears; that has a status, and momentum all the
    same.
    """
    model, params, state = soft(jittered(seed, 0.05), material)
    state = started(model, state, seed, amount, dt)
    places, speeds, status = run(model, params, state, dt)
    mass = np.asarray(model.nodal_volumes) * float(material["density"])
    before, after = mass @ np.asarray(state.velocities), mass @ speeds
    assert all(code == 0 or "turned too far" in describe(code) for code in status), describe(status)
    fastest = max(np.abs(np.asarray(state.velocities)).max(), SIDE / dt)
    np.testing.assert_allclose(after, before, atol=1e-8 * mass.sum() * fastest)
    way = mass @ (places - np.asarray(state.positions)) / mass.sum()
    np.testing.assert_allclose(way, STEPS * dt * before / mass.sum(), atol=1e-8 * STEPS * dt * fastest)


@few
@given(seeds, materials, steps, some.floats(0, 0.3), some.integers(0, 2))
def test_what_is_mirrored_moves_mirrored(seed, material, dt, amount, axis):
    """The box is its own mirror image, with its nodes exchanged."""
    model, params, state = soft(box_mesh(), material)
    state = started(model, state, seed, amount, dt)
    mirror = np.where(np.arange(3) == axis, -1.0, 1.0)
    rest = np.asarray(model.rest)
    image = np.linalg.norm(rest[:, None] - (rest * mirror)[None], axis=2).argmin(1)
    other = state.replace(positions=(state.positions * mirror)[image], velocities=(state.velocities * mirror)[image])
    places, _, status = run(model, params, state, dt)
    mirrored, _, again = run(model, params, other, dt)
    assert (status == 0).all() and (again == 0).all()
    np.testing.assert_allclose(mirrored, (places * mirror)[image], atol=1e-6 * max(SIDE, np.abs(places).max()))


@few
@given(
    seeds,
    some.sampled_from(["young", "poisson", "density", "damping", "gravity", "positions", "velocities"]),
    some.sampled_from(NASTY),
    steps,
)
def test_no_nan_without_a_status(seed, where, value, dt):
    """Whatever is put into one input: the numbers are finite, or the status says so."""
    material = {"young": 1e5, "poisson": 0.3, "density": 1e3, "damping": 0.01}
    model, params, state = soft(box_mesh(), material)
    state = started(model, state, seed, 0.1, dt)
    if where in ("positions", "velocities"):
        state = state.replace(**{where: getattr(state, where).at[seed % 35, seed % 3].set(value)})
    elif where == "gravity":
        params = params.replace(gravity=params.gravity.at[seed % 3].set(value))
    else:
        params = params.replace(**{where: jnp.full_like(params.constants[where], value)})
    places, speeds, status = run(model, params, state, dt)
    assert status.any() or (np.isfinite(places).all() and np.isfinite(speeds).all())


@functools.cache
def pendulum():
    """Two links of a chain, free in space."""
    links = [jf.RigidBody(jf.Box((0.2, 0.1, 0.05)), mass=1.0, position=(0.2 * k, 0, 0), name=f"{k}") for k in range(3)]
    joints = [jf.BallJoint(links[k], links[k + 1], (0.2 * k + 0.1, 0, 0)) for k in range(2)]
    return jf.build(jf.Scene(links, (0, 0, 0), joints=joints), tolerance=1e-12)


@few
@given(seeds, some.floats(0, 3), some.floats(-1, 2).map(lambda power: 10**power))
def test_jointed_bodies_keep_momentum_and_turn_with_the_frame(seed, power, speed):
    """Any masses, any spin: linear momentum is kept, and a turned start moves turned."""
    model, params, state = pendulum()
    random = np.random.default_rng(seed)
    mass = jnp.asarray(10 ** random.uniform(-power, power, 3))
    params = params.replace(rigid=params.rigid.replace(mass=mass))
    spin = jnp.asarray(random.normal(0, speed, (3, 3)))
    start = state.replace(rigid=state.rigid.replace(angular_velocities=spin))
    states, infos = jf.rollout(model, params, start, 1e-3, STEPS)
    ends = states.rigid
    scale = float(mass.sum()) * max(1.0, speed)
    np.testing.assert_allclose(mass @ ends.velocities[-1], np.zeros(3), atol=1e-8 * scale)
    unit = random.standard_normal(4)
    quaternions = jnp.broadcast_to(jnp.asarray(unit / np.linalg.norm(unit)), (3, 4))
    turn = np.asarray(jf.rotation.quaternion_to_matrix(quaternions[0]))
    turned = start.rigid.replace(
        positions=start.rigid.positions @ turn.T, orientations=quaternions, angular_velocities=spin @ turn.T
    )
    others, again = jf.rollout(model, params, start.replace(rigid=turned), 1e-3, STEPS)
    assert not infos.status.any() and not again.status.any()
    np.testing.assert_allclose(others.rigid.positions[-1], ends.positions[-1] @ turn.T, atol=1e-7 * max(1.0, speed))
