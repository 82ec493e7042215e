"""Joints: against closed forms, momentum, what is redundant or contradictory, soft attachments, limits and motors."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.rigid.dynamics import angular_momentum
from jaxfem.solvers import Status

NOTHING = (0.0, 0.0, 0.0)
EXACT = {"tolerance": 1e-12}


def rod(angle, **kwargs):
    """A rod of 1 m and 1 kg whose upper end is at the origin, hanging at an angle from the vertical [rad]."""
    return jf.RigidBody(
        jf.Box((0.1, 0.1, 1.0)),
        mass=1.0,
        position=(0.5 * np.sin(angle), 0, -0.5 * np.cos(angle)),
        orientation=(np.cos(angle / 2), 0, -np.sin(angle / 2), 0),
        **kwargs,
    )


@jax.jit
def total_energy(model, params, states):
    parts = jax.vmap(lambda s: jf.energies(model, params, s))(states)
    return parts.kinetic + parts.elastic + parts.gravity


@pytest.mark.parametrize("joint", ["ball", "hinge"])
def test_a_pendulum_has_its_period_and_keeps_its_energy(joint):
    body, dt = rod(0.1), 1e-2
    joints = {"ball": jf.BallJoint(body, None, NOTHING), "hinge": jf.HingeJoint(None, body, NOTHING, (0, 1, 0))}
    model, params, state = jf.build(jf.Scene([body], joints=[joints[joint]]), **EXACT)
    states, info = scenes.rolled(model, params, state, dt, 400)
    assert not info.status.any()
    x = np.asarray(states.rigid.positions[:, 0, 0])
    before = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
    period = np.diff(dt * (before + x[before] / (x[before] - x[before + 1])))
    inertia = (1 + 0.01) / 12 + 0.25
    np.testing.assert_allclose(period, 2 * np.pi * np.sqrt(inertia / (9.81 * 0.5)) * (1 + 0.1**2 / 16), rtol=1e-4)
    energy = total_energy(model, params, states)
    assert jnp.abs(energy - energy[0]).max() < 0.04 * (energy - state.rigid.positions[0, 2]).max() + 1e-3


@pytest.mark.slow
def test_a_physical_double_pendulum_keeps_its_energy():
    """From the horizontal: the energy error is of first order in the step, and its drift over 2 s small."""
    first = jf.RigidBody(jf.Box((1.0, 0.1, 0.1)), mass=1.0, position=(0.5, 0, 0))
    second = jf.RigidBody(jf.Box((1.0, 0.1, 0.1)), mass=1.0, position=(1.5, 0, 0))
    joints = [jf.BallJoint(first, None, NOTHING), jf.BallJoint(first, second, (1.0, 0, 0))]
    model, params, state = jf.build(jf.Scene([first, second], joints=joints), **EXACT)
    errors = []
    for dt in (2e-3, 1e-3):
        states, _ = scenes.rolled(model, params, state, dt, round(2 / dt), 100)
        energy = total_energy(model, params, states)
        errors.append(float(jnp.abs(energy).max()))
        kinetic = jax.vmap(lambda s: jf.energies(model, params, s).kinetic)(states).max()
    assert errors[1] < 0.01 * kinetic
    assert 1.6 < errors[0] / errors[1] < 2.6


def test_a_top_precesses_at_its_slow_rate():
    """Steady precession: I3 w3 W = m g l + I1 W^2 cos a, w3 the whole spin about the axis (Goldstein)."""
    lean, length, spin, mass = 0.3, 0.1, 200.0, 1.0
    i3, i1 = 0.002, 0.0015 + mass * length**2
    a, b, c = i1 * np.cos(lean), -i3 * spin, mass * 9.81 * length
    rate = (-b - np.sqrt(b * b - 4 * a * c)) / (2 * a)
    axis = np.array([np.sin(lean), 0, np.cos(lean)])
    omega = spin * axis + rate * (np.array([0, 0, 1.0]) - np.cos(lean) * axis)
    top = jf.RigidBody(
        jf.Sphere(0.05),
        mass=mass,
        inertia=np.diag([0.0015, 0.0015, 0.002]),
        position=length * axis,
        orientation=(np.cos(lean / 2), 0, np.sin(lean / 2), 0),
        angular_velocity=omega,
        velocity=np.cross(omega, length * axis),
    )
    model, params, state = jf.build(jf.Scene([top], joints=[jf.BallJoint(top, None, NOTHING)]), **EXACT)
    states, _ = scenes.rolled(model, params, state, 1e-3, 500)
    x = states.rigid.positions[:, 0]
    turned = jnp.unwrap(jnp.arctan2(x[:, 1], x[:, 0]))
    assert float(turned[-1]) / 0.5 == pytest.approx(rate, rel=0.01)
    np.testing.assert_allclose(x[:, 2], length * np.cos(lean), rtol=0.01)


def test_joints_pass_momentum_on_to_rounding():
    rng = np.random.default_rng(1)
    bodies = [
        jf.RigidBody(jf.Box((0.4, 0.2, 0.1)), mass=1.0 + i, position=(i, 0, 0), angular_velocity=rng.normal(size=3))
        for i in range(3)
    ]
    joints = [jf.BallJoint(bodies[0], bodies[1], (0.5, 0, 0)), jf.WeldJoint(bodies[1], bodies[2], (1.5, 0, 0))]
    model, params, state = jf.build(jf.Scene(bodies, gravity=NOTHING, joints=joints), tolerance=1e-14)
    states, _ = jf.rollout(model, params, state, 1e-3, 60)
    mass = params.rigid.mass[:, None]

    def momenta(rigid):
        linear = mass * rigid.velocities
        spin = angular_momentum(model.rigid, params.rigid.mass, rigid)
        return jnp.sum(linear, 0), jnp.sum(spin + jnp.cross(rigid.positions, linear), 0)

    linear, angular = jax.vmap(momenta)(states.rigid)
    start = momenta(state.rigid)
    assert jnp.abs(linear - start[0]).max() < 1e-13
    # to rounding times the drift of the anchors, which is of the order of dt^2
    assert jnp.abs(angular - start[1]).max() < 2e-6


def hanging_force(model, params, state, steps=300, dt=1e-2):
    states, info = jf.rollout(model, params, state, dt, steps)
    assert not info.status.any()
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    return last, {name: impulse / dt for name, impulse in jf.impulses(model, last).items()}


@pytest.mark.slow
def test_redundant_joints_share_the_load_and_contradictory_ones_stay_finite():
    body = jf.RigidBody(jf.Sphere(0.1), mass=2.0, position=(0, 0, -0.5))
    four = [jf.BallJoint(None, body, NOTHING) for _ in range(4)]
    _, forces = hanging_force(*jf.build(jf.Scene([body], joints=four), **EXACT), steps=20)
    (shared,) = forces.values()
    np.testing.assert_allclose(shared.sum(0), [0, 0, 2 * 9.81], atol=1e-6)
    np.testing.assert_allclose(shared, np.tile([0, 0, 2 * 9.81 / 4], (4, 1)), atol=1e-6)
    apart = [jf.BallJoint(None, body, (x, 0, 0), anchor_b=NOTHING) for x in (-0.1, 0.1)]
    states, info = jf.rollout(*jf.build(jf.Scene([body], joints=apart)), 1e-2, 50)
    assert {Status(int(each)) for each in info.status} == {Status.CONTRADICTORY_JOINTS}
    np.testing.assert_allclose(states.rigid.positions[-1, 0], [0, 0, -0.5], atol=1e-5)


@pytest.mark.slow
def test_a_chain_holds_a_thousand_times_its_mass():
    """Ten links with the mass on the last: in statics each joint carries what hangs below it."""
    links = [jf.RigidBody(jf.Sphere(0.3), mass=1.0, position=(0, 0, -i - 0.5)) for i in range(9)]
    heavy = jf.RigidBody(jf.Sphere(0.5), mass=1000.0, position=(0, 0, -9.5))
    bodies = [None, *links, heavy]
    joints = [jf.BallJoint(bodies[i], bodies[i + 1], (0, 0, -i)) for i in range(10)]
    model, params, state = jf.build(jf.Scene([*links, heavy], joints=joints), **EXACT)
    _, together = hanging_force(model, params, state, steps=100, dt=1 / 60)
    below = 9.81 * (1000.0 + np.arange(9, -1, -1))
    found = np.concatenate([together["joint point world-rigid"], together["joint point rigid-rigid"]])
    np.testing.assert_allclose(found[:, 2], below, rtol=1e-6)


def test_limits_hold_and_a_motor_lifts_what_it_can():
    """A rod on a hinge with its torque bound at half of what holds it level: it comes to rest at sin a = 1/2."""
    torque = 0.5 * 9.81 * 0.5
    body = rod(0.0)
    hinge = jf.HingeJoint(None, body, NOTHING, (0, -1, 0), motor=jf.Motor(100.0, torque), damping=0.0)
    slow = jf.RigidBody(jf.Box((0.1, 0.1, 1.0)), mass=1.0, position=(3, 0, -0.5))
    limited = jf.HingeJoint(None, slow, (3, 0, 0), (0, -1, 0), low=-0.2, high=0.4, motor=jf.Motor(2.0, 50.0))
    model, params, state = jf.build(jf.Scene([body, slow], joints=[hinge, limited]), **EXACT)
    states, info = jf.rollout(model, params, state, 1e-2, 100)
    assert not info.status.any()
    place = states.rigid.positions[:, :, 0] - jnp.array([0.0, 3.0])
    angle = jnp.arctan2(place, -states.rigid.positions[:, :, 2])
    np.testing.assert_allclose(angle[-1, 1], 0.4, atol=1e-6)
    # with a constant torque the rod swings about 30 degrees, between 0 and its mirror image
    assert abs(float(angle[:, 0].max()) - swing_limit()) < 0.02


def swing_limit():
    """Where m g l (1 - cos a) = torque a, with torque = m g l / 2."""
    a = np.linspace(0.5, 2.0, 100_001)
    return a[np.argmin(np.abs(1 - np.cos(a) - a / 2))]


def test_a_slider_travels_along_its_axis_only_and_stops_at_its_limit():
    axis = np.array([1.0, 0, -1.0]) / np.sqrt(2)
    body = jf.RigidBody(jf.Box((0.2, 0.1, 0.1)), mass=2.0, angular_velocity=(0, 0, 0))
    slider = jf.SliderJoint(None, body, NOTHING, axis, high=0.5)
    model, params, state = jf.build(jf.Scene([body], joints=[slider]), **EXACT)
    states, _ = jf.rollout(model, params, state, 1e-2, 60)
    path = states.rigid.positions[:, 0]
    t = 0.2
    np.testing.assert_allclose(path[19], axis * 9.81 / np.sqrt(2) * t * (t + 1e-2) / 2, atol=1e-7)
    np.testing.assert_allclose(path[-1], 0.5 * axis, atol=1e-7)
    np.testing.assert_allclose(states.rigid.orientations[-1, 0], [1, 0, 0, 0], atol=1e-9)


def test_a_rope_goes_slack_and_a_compliant_joint_is_a_spring():
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, -0.5))
    rope = jf.DistanceJoint(None, ball, NOTHING, (0, 0, -0.5), length=1.0, rope=True)
    spring = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(2, 0, 0))
    soft = jf.BallJoint(None, spring, (2, 0, 0), compliance=1e-3, damping=20.0)
    model, params, state = jf.build(jf.Scene([ball, spring], joints=[rope, soft]), **EXACT)
    states, _ = jf.rollout(model, params, state, 1e-2, 150)
    height = states.rigid.positions[:, 0, 2]
    t = 0.2
    np.testing.assert_allclose(height[19], -0.5 - 9.81 * t * (t + 1e-2) / 2, atol=1e-9)  # free while slack
    np.testing.assert_allclose(height[-1], -1.0, atol=1e-7)
    np.testing.assert_allclose(states.rigid.positions[-1, 1, 2], -9.81e-3, rtol=1e-4)


@pytest.mark.slow
def test_welded_soft_halves_sag_like_the_whole():
    material = {"young": 1e5, "poisson": 0.3, "density": 1000.0, "damping": 0.05}
    whole = jf.SoftBody(jf.mesh.box((0.4, 0.1, 0.1), (4, 1, 1)), fixed="x-", **material)
    left = jf.SoftBody(jf.mesh.box((0.2, 0.1, 0.1), (2, 1, 1), name="left"), fixed="x-", **material)
    right = jf.SoftBody(jf.mesh.box((0.2, 0.1, 0.1), (2, 1, 1), origin=(0.2, 0, 0), name="right"), **material)
    weld = jf.WeldJoint(right, left, nodes="x-")
    sags = []
    for scene in (jf.Scene([whole]), jf.Scene([left, right], joints=[weld])):
        model, params, state = jf.build(scene, tolerance=1e-8)
        states, info = jf.rollout(model, params, state, 0.1, 40)
        assert not info.status.any()
        tip = model.rest[:, 0] > 0.4 - 1e-9
        sags.append(float(jnp.mean((states.positions[-1] - model.rest)[tip, 2])))
    assert sags[0] < -0.005
    assert sags[1] == pytest.approx(sags[0], rel=1e-5)


def test_a_tool_on_a_soft_arm_weighs_on_it_and_momentum_is_kept():
    mesh = jf.mesh.box((0.3, 0.1, 0.1), (3, 1, 1))
    arm = jf.SoftBody(mesh, young=1e5, poisson=0.3, density=500.0, velocity=(0.1, 0.0, 0.2))
    tool = jf.RigidBody(jf.Box((0.1, 0.1, 0.1)), mass=0.7, position=(0.35, 0.05, 0.05), angular_velocity=(0, 5.0, 1.0))
    weld = jf.WeldJoint(arm, tool, nodes="x+")
    model, params, state = jf.build(jf.Scene([arm, tool], gravity=NOTHING, joints=[weld]), tolerance=1e-13)
    states, info = jf.rollout(model, params, state, 1e-2, 20)
    assert not info.status.any()
    nodal = 500.0 * model.nodal_volumes[:, None]
    total = jnp.sum(nodal * states.velocities, 1) + 0.7 * states.rigid.velocities[:, 0]
    np.testing.assert_allclose(total, np.tile(1.5 * np.array([0.1, 0, 0.2]), (20, 1)), atol=1e-13)


@pytest.mark.slow
def test_derivatives_through_a_motor_joint_and_a_compliant_one():
    """At the bound of the motor's torque; in that bound, the mass, and the other joint's compliance."""
    link = jf.RigidBody(jf.Box((0.2, 0.05, 0.05)), mass=0.3, position=(0.3, 0.05, 0.05))
    tool = jf.RigidBody(jf.Box((0.2, 0.05, 0.05)), mass=0.3, position=(0.5, 0.05, 0.05))
    motor = jf.HingeJoint(link, tool, (0.4, 0.05, 0.05), (0, 1, 0), motor=jf.Motor(50.0, 0.2))
    tie = jf.BallJoint(None, link, (0.2, 0.05, 0.05), compliance=1e-3, damping=5.0)
    model, params, state = jf.build(jf.Scene([link, tool], joints=[motor, tie]), tolerance=1e-13)

    def end(strength, compliance, mass):
        joints = dict(params.joints)
        for name, field, factor in (
            ("angle motor rigid-rigid", "strength", strength),
            ("point world-rigid", "compliance", compliance),
        ):
            joints[name] = joints[name].replace(**{field: factor * getattr(joints[name], field)})
        values = params.replace(joints=joints, rigid=params.rigid.replace(mass=mass * params.rigid.mass))
        states, _ = jf.rollout(model, values, state, 1e-2, 10)
        return states.rigid.positions[-1, 1, 2] + 0.1 * states.rigid.orientations[-1, 1, 2]

    derivatives.check(end, (1.0, 1.0, 1.0), forwards=False)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda s, r: jf.BallJoint(None, None, NOTHING), "the world to itself"),
        (lambda s, r: jf.BallJoint(r, "nobody", NOTHING), 'names "nobody", which is not a body'),
        (lambda s, r: jf.BallJoint(r, s, (9.0, 0, 0)), "outside it"),
        (lambda s, r: jf.HingeJoint(r, s, NOTHING, (0, 0, 1)), "needs an orientation"),
        (lambda s, r: jf.HingeJoint(r, None, NOTHING, (0, 0, 0)), "give a direction"),
        (lambda s, r: jf.HingeJoint(r, None, NOTHING, (0, 0, 1), low=1.0, high=0.0), "low <= high"),
        (lambda s, r: jf.HingeJoint(r, None, NOTHING, (0, 0, 1), high=4.0), "from -pi to pi"),
        (lambda s, r: jf.SliderJoint(r, None, NOTHING, (0, 0, 1), motor=3.0), "give a Motor"),
        (lambda s, r: jf.WeldJoint(s, r), "give the `nodes`"),
        (lambda s, r: jf.WeldJoint(r, None, nodes=[0]), "belong to a soft body"),
        (lambda s, r: jf.DistanceJoint(r, None, NOTHING, NOTHING), "use a BallJoint"),
        (lambda s, r: jf.BallJoint(r, None, NOTHING, compliance=-1), "at least 0"),
        (lambda s, r: jf.Motor(1.0, -2.0), "at least 0"),
        (lambda s, r: 3, "no list of joints"),
    ],
)
def test_impossible_joints_are_refused(make, text):
    soft = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), young=1e5, poisson=0.3, density=1e3, name="soft")
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, name="ball")
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([soft, ball], joints=[make(soft, ball)]))
