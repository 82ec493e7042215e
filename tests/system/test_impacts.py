"""Impacts within a step: where bodies are after them, and derivatives across them, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.rigid.dynamics import angular_momentum

GRAVITY = 9.81
NOTHING = (0.0, 0.0, 0.0)


def dropped(h0, plane, e, v0, time):
    """Height of a point that falls from `h0` with speed `v0` upwards and bounces once off a `plane`."""
    until = (v0 + jnp.sqrt(v0**2 + 2 * GRAVITY * (h0 - plane))) / GRAVITY
    left = time - until
    return plane + e * (GRAVITY * until - v0) * left - GRAVITY / 2 * left**2


@pytest.fixture(scope="module")
def ball():
    """The height of a rigid ball after a number of steps, and its derivatives, as one program for all steps."""
    body = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 1.1))
    ground = jf.Contact(body, jf.Plane(), restitution=0.5, friction=0.0)
    model, params, state = jf.build(jf.Scene([body], contacts=[ground]), tolerance=1e-12)
    (name,) = model.contacts

    def height(values, dt, steps):
        h0, plane, e, v0 = values
        group, numbers = model.contacts[name], params.contacts[name]
        ground = group.shape.replace(point=jnp.array([[0, 0, 1.0]]) * plane)
        own = model.replace(contacts={name: group.replace(shape=ground)})
        with_e = params.replace(contacts={name: numbers.replace(restitution=e[None])})
        up = jnp.array([[0, 0, 1.0]])
        start = state.rigid.replace(positions=up * (h0 + 0.1), velocities=up * v0)
        end = jax.lax.fori_loop(0, steps, lambda _, s: jf.step(own, with_e, s, dt)[0], state.replace(rigid=start))
        return (end.rigid.positions[0, 2] - 0.1,) * 2

    return jax.jit(lambda *given: jax.jacfwd(height, has_aux=True)(*given)[::-1])


VALUES = jnp.array([1.0, 0.0, 0.5, 0.0])


def test_a_bounce_and_its_derivatives_converge_to_the_closed_form(ball):
    time = 0.65
    wanted, slopes = dropped(*VALUES, time), jax.grad(lambda v: dropped(*v, time))(VALUES)
    errors = []
    for parts in (1, 4, 16):
        found, own = ball(VALUES, time / (39 * parts), 39 * parts)
        errors.append([abs(float(found - wanted)), *np.abs(own - slopes)])
    errors = np.array(errors)
    assert (errors[0] < [3e-3, 0.03, 0.03, 0.04, 0.008]).all()
    assert (errors[1:] < 0.35 * errors[:-1]).all()  # first order: a quarter
    # What is left is that symplectic Euler's velocities lag by half a step.
    ahead = VALUES.at[3].add(GRAVITY / 2 * time / 39)
    np.testing.assert_allclose(ball(ahead, time / 39, 39)[0], wanted, rtol=1e-7)


@pytest.mark.parametrize("dt", [1 / 30, 1 / 60, 1e-3])
def test_tops_are_those_of_restitution_squared_at_any_step(ball, dt):
    fall, e = np.sqrt(2 / GRAVITY), 0.5
    times = fall * (1 + e), fall * (1 + 2 * e + e**2)  # a top is flat: a step more or less is nothing
    tops = [max(float(ball(VALUES, dt, round(time / dt) + k)[0]) for k in range(-1, 2)) for time in times]
    np.testing.assert_allclose(tops, [0.25, 0.0625], rtol=0.05)


@pytest.mark.parametrize("method", ["direct", pytest.param("pgs", marks=pytest.mark.slow)])
def test_without_forces_bounces_are_exact_at_any_step_and_in_one_step_at_different_times(method):
    """Balls of many speeds against a wall and one on a rope, all in steps of 50 ms; two that meet in flight beside."""
    speeds, es = np.array([-1.0, -1.3, -2.1, -3.7]), np.array([0.5, 1.0, 0.2, 0.9])
    lone = [
        jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, k, 0.5), velocity=(0.3, 0, v), name=f"lone {k}")
        for k, v in enumerate(speeds)
    ]
    left = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(-1, 9, 0.5), velocity=(1.5, 0, 0), name="left")
    right = jf.RigidBody(jf.Sphere(0.1), mass=2.0, position=(0, 9, 0.5), velocity=(-0.4, 0, 0), name="right")
    roped = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 20, 0.5), velocity=(0.0, 1.7, 0), name="roped")
    contacts = [
        *(jf.Contact(b, jf.Plane(), restitution=e, friction=0.0) for b, e in zip(lone, es, strict=True)),
        jf.Contact(left, right, restitution=0.8, friction=0.0),
    ]
    rope = jf.DistanceJoint(None, roped, (0, 20, 0.5), (0, 20, 0.5), length=0.47, rope=True)
    scene = jf.Scene([*lone, left, right, roped], joints=[rope], contacts=contacts, gravity=NOTHING)
    model, params, state = jf.build(scene, solver=method, tolerance=1e-12)

    def ends(scale):
        start = state.replace(rigid=state.rigid.replace(velocities=scale * state.rigid.velocities))
        states, info = jf.rollout(model, params, start, 0.05, 16)
        return states.rigid.positions[-1], info.status.max()

    (found, status), (slope, _) = jax.jvp(ends, (1.0,), (1.0,))
    assert not status
    time = 0.8

    def exact(scale):
        bounced = scale * speeds
        meets = 0.4 / -bounced
        z = jnp.where(meets < time, 0.1 - es * bounced * (time - meets), 0.5 + bounced * time)
        met = 0.8 / (1.9 * scale)
        after = scale * (1.5 - 1.8 * 1.9 * 2 / 3), scale * (-0.4 + 1.8 * 1.9 / 3)
        x = [x0 + scale * v * met + w * (time - met) for x0, v, w in ((-1, 1.5, after[0]), (0, -0.4, after[1]))]
        return jnp.concatenate([z, jnp.array(x), jnp.array([20.47])])

    wanted, slopes = jax.jvp(exact, (1.0,), (1.0,))
    for given, known, atol in ((found, wanted, 1e-7), (slope, slopes, 1e-6)):
        np.testing.assert_allclose(jnp.concatenate([given[:4, 2], given[4:6, 0], given[6:, 1]]), known, atol=atol)
    np.testing.assert_allclose(found[:4, 0], 0.3 * time, atol=1e-9)  # nothing slows them along the wall


@pytest.mark.slow
def test_bodies_that_strike_in_flight_keep_both_momenta_and_gain_no_energy():
    """Two spinning boxes off centre, a ball that grazes another with friction; steps of 20 ms."""
    one = jf.RigidBody(jf.Box((0.2, 0.3, 0.2)), mass=1.0, position=(-0.5, 0, 0), velocity=(3, 0.5, 0), name="one")
    two = jf.RigidBody(jf.Box((0.3, 0.2, 0.2)), mass=3.0, position=(0.3, 0.17, 0.03), velocity=(-1, 0, 0), name="two")
    left = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(-0.4, 5, 0), velocity=(2, 0.3, 0), name="left")
    right = jf.RigidBody(jf.Sphere(0.15), mass=2.0, position=(0.3, 5.1, 0.05), name="right")
    contacts = [
        jf.Contact(one, two, restitution=0.7, friction=0.3),
        jf.Contact(left, right, restitution=0.7, friction=0.3),
    ]
    scene = jf.Scene([one, two, left, right], gravity=NOTHING, contacts=contacts)
    model, params, state = jf.build(scene, tolerance=1e-12)
    spins = jnp.array([[1.0, 2, 3], [0.5, -1, 2], [0, 0, 4.0], [0, 0, 0]])
    state = state.replace(rigid=state.rigid.replace(angular_velocities=spins))
    states, info = jf.rollout(model, params, state, 0.02, 20)
    assert not info.status.any()
    mass, rigid = params.rigid.mass, states.rigid
    assert float(jnp.abs(rigid.velocities[-1] - rigid.velocities[0]).min(axis=1).max()) > 0.01
    energies = jax.vmap(lambda s: jf.energies(model, params, s).kinetic)(states)
    assert float(energies.max()) <= float(energies[0]) * (1 + 1e-9)
    spin = jax.vmap(lambda r: angular_momentum(model.rigid, mass, r))(rigid)
    for pair in (slice(0, 2), slice(2, 4)):
        momentum = mass[pair, None] * rigid.velocities[:, pair]
        whole = jnp.sum(spin[:, pair] + jnp.cross(rigid.positions[:, pair], momentum), axis=1)
        for kept in (momentum.sum(1), whole):
            np.testing.assert_allclose(kept, jnp.broadcast_to(kept[0], kept.shape), atol=1e-9)


@pytest.mark.slow
def test_a_hinge_that_strikes_its_limit_falls_back_as_a_fine_integration_says():
    """A rod swings up against a limit and falls from it: d angle / d start rate is that of the time it struck."""
    rod = jf.RigidBody(jf.Box((1.0, 0.05, 0.05)), mass=1.0, position=(0.5, 0, 0))
    hinge = jf.HingeJoint(None, rod, NOTHING, (0, 1, 0), low=-0.4, high=3.0)
    model, params, state = jf.build(jf.Scene([rod], joints=[hinge]), tolerance=1e-12)
    time, rate = 0.4, 4.0

    def angle(rate, dt, steps):
        spin = jnp.array([[0, -1.0, 0]]) * rate
        start = state.rigid.replace(angular_velocities=spin, velocities=jnp.cross(spin, state.rigid.positions))
        end = jax.lax.fori_loop(0, steps, lambda _, s: jf.step(model, params, s, dt)[0], state.replace(rigid=start))
        return 2 * jnp.arctan2(end.rigid.orientations[0, 2], end.rigid.orientations[0, 0])

    program = jax.jit(lambda *given: jax.jvp(lambda r: angle(r, *given[1:]), given[:1], (jnp.ones(()),)))
    wanted = np.array([_rod(rate, time), (_rod(rate + 1e-2, time) - _rod(rate - 1e-2, time)) / 2e-2])
    found = np.array([program(rate, time / n, n) for n in (96, 384, 1536)])
    errors = np.abs(found - wanted)
    assert abs(wanted[1]) > 0.2 and (errors[0] < (0.01, 0.06)).all()
    assert (errors[1:] < 0.4 * errors[:-1]).all()


def _rod(rate, time, steps=4000):
    """Angle of the rod by Runge and Kutta's method, stopped dead where it strikes -0.4 rad."""
    h = time / steps
    inertia = 1 / 3 + 2 * 0.05**2 / 12 - 0.05**2 / 12  # of the box about its end
    pull = GRAVITY * 0.5 / inertia
    angle, speed = 0.0, -rate
    for _ in range(steps):
        k1, a1 = speed, pull * np.cos(angle)
        k2, a2 = speed + h / 2 * a1, pull * np.cos(angle + h / 2 * k1)
        k3, a3 = speed + h / 2 * a2, pull * np.cos(angle + h / 2 * k2)
        k4, a4 = speed + h * a3, pull * np.cos(angle + h * k3)
        following, speed_after = (
            angle + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4),
            speed + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4),
        )
        if following < -0.4 and speed_after < 0:
            left = h * (following + 0.4) / (following - angle)
            following, speed_after = -0.4 + pull * np.cos(0.4) * left**2 / 2, pull * np.cos(0.4) * left
        angle, speed = following, speed_after
    return angle
