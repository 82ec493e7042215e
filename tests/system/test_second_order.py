"""Second-order steps of soft bodies with contacts, joints and ropes: order, impacts without an echo, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

SCHEMES = ("generalized_alpha", "backward_euler")


def block_on_floor():
    """A block that lies on a smooth floor, sheared as it starts."""
    mesh = jf.mesh.box((0.3, 0.1, 0.1), (3, 1, 1), tets_per_cell=5)
    speed = 0.5 * mesh.points[:, 2:] * np.array([1.0, 0.0, 0.0])
    body = jf.SoftBody(mesh, young=2e4, poisson=0.3, density=1000.0, damping=1e-3, velocity=speed)
    return jf.Scene([body], contacts=[jf.Contact(body, jf.Plane())])


def hanging_arm():
    """An arm that swings down from a ball joint."""
    mesh = jf.mesh.box((0.4, 0.05, 0.05), (4, 1, 1), tets_per_cell=5)
    body = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, damping=1e-4)
    return jf.Scene([body], joints=[jf.BallJoint(body, None, (0.0, 0.025, 0.025))])


def falling_cube(young, friction=0.0, velocity=-2.0):
    mesh = jf.mesh.box((0.1, 0.1, 0.1), 2, tets_per_cell=5, origin=(0, 0, 0.02))
    body = jf.SoftBody(mesh, young=young, poisson=0.3, density=1000.0, damping=1e-3, velocity=(0, 0, velocity))
    return jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=friction)])


def ends(scene, scheme, time, steps, **options):
    """Positions at `time`, for each number of steps; by single steps, which are compiled once."""
    model, params, start = jf.build(scene, scheme=scheme, tolerance=1e-11, **options)
    found = []
    for count in steps:
        state, ready = start, jf.prepare(model, params, start, time / count)
        for _ in range(count):
            state, info = jf.step(ready, params, state, time / count)
            assert info.status == 0
        found.append(np.asarray(state.positions))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("make", "time", "first"), [(block_on_floor, 0.08, 16), (hanging_arm, 0.32, 64)])
def test_order_two_with_closed_contacts_and_joints(make, time, first):
    steps = (first, 2 * first, 4 * first)
    *found, fine = ends(make(), "generalized_alpha", time, (*steps, 16 * first))
    errors = [np.abs(each - fine).max() for each in found]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(order - 2) < 0.3
    (plain,) = ends(make(), "backward_euler", time, steps[:1])
    assert np.abs(plain - fine).max() > 8 * errors[0]


@pytest.mark.slow
def test_all_rows_give_the_same():
    (condensed,) = ends(hanging_arm(), "generalized_alpha", 0.1, (10,))
    (rows,) = ends(hanging_arm(), "generalized_alpha", 0.1, (10,), solver="mprgp")
    np.testing.assert_allclose(condensed, rows, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_an_impact_leaves_no_echo(dtype):
    """A stiff cube drops and stays: accelerations of the impact would throw it up again by an eighth of its speed."""
    model, params, state = jf.build(falling_cube(1e7, friction=0.5), scheme=SCHEMES[0], dtype=dtype)
    states, info = jf.rollout(model, params, state, 1e-2, 60)
    assert not info.status.any()
    height = np.asarray(states.positions[..., 2]).mean(1)
    assert height[10:].max() < 0.0501 and states.positions[..., 2].min() > -1e-4
    assert np.abs(states.velocities[-1]).max() < 2e-3


@pytest.mark.slow
def test_a_bounce_is_as_good_as_one_of_many_more_plain_steps():
    time, scene = 0.05, falling_cube(1e5)
    (fine,) = ends(scene, "generalized_alpha", time, (400,))
    errors = {scheme: np.abs(ends(scene, scheme, time, (20,))[0] - fine).mean() for scheme in SCHEMES}
    assert errors["generalized_alpha"] < 0.25 * errors["backward_euler"]


def test_a_rope_goes_taut_and_holds():
    mesh = jf.mesh.box((0.1, 0.1, 0.1), 1, tets_per_cell=5)
    body = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, damping=1e-3)
    top, hook = (0.05, 0.05, 0.1), (0.05, 0.05, 0.4)
    scene = jf.Scene([body], joints=[jf.DistanceJoint(body, None, top, hook, length=0.35, rope=True)])
    model, params, state = jf.build(scene, scheme=SCHEMES[0], tolerance=1e-10)
    states, info = jf.rollout(model, params, state, 5e-3, 120)
    assert not info.status.any()
    cap = np.isclose(mesh.points[:, 2], 0.1)
    drop = 0.1 - np.asarray(states.positions)[:, cap, 2].mean(1)
    assert drop.max() < 0.0506 and drop[-20:].min() > 0.0495


@pytest.mark.slow
def test_derivative_of_a_landing_in_its_stiffness():
    model, params, state = jf.build(falling_cube(2e4, friction=0.3), scheme=SCHEMES[0], tolerance=1e-13)

    def height(young, damping):
        values = params.replace(young=young * params.young, damping=damping * params.damping)
        states, _ = jf.rollout(model, values, state, 4e-3, 8)
        return jnp.mean(states.positions[-1] @ jnp.array([0.2, 0.0, 1.0]))

    derivatives.check(height, (1.0, 1.0))


@pytest.mark.slow
def test_lanes_strike_each_at_its_own_time():
    model, params, state = jf.build(falling_cube(1e5), scheme=SCHEMES[0], tolerance=1e-10)
    speeds = jnp.stack([state.velocities, 2 * state.velocities])

    def run(velocities):
        return jf.rollout(model, params, state.replace(velocities=velocities), 4e-3, 6)[0].positions[-1]

    together = jax.vmap(run)(speeds)
    for lane, alone in zip(together, map(run, speeds), strict=True):
        np.testing.assert_allclose(lane, alone, atol=1e-9)


@pytest.mark.slow
def test_what_strikes_one_body_is_nothing_to_another():
    """A beam rings alone as it does beside a cube that bounces; the cube's scheme_damping is then backward Euler's."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    beam = jf.SoftBody(mesh, young=2.6e5, poisson=0.4, density=1000.0, fixed="x-", strain="smoothed")
    small = jf.mesh.box((0.05, 0.05, 0.05), 1, tets_per_cell=5, origin=(1, 0, 0.005))
    cube = jf.SoftBody(small, young=1e5, poisson=0.3, density=1000.0, damping=1e-3, velocity=(0, 0, -1.0))
    options = {"scheme": SCHEMES[0], "tolerance": 1e-10}
    alone = jf.build(jf.Scene([beam]), **options)
    model, *both = jf.build(jf.Scene([beam, cube], contacts=[jf.Contact(cube, jf.Plane(), restitution=0.8)]), **options)
    model = jf.prepare(model, *both, 2e-3, frequencies=[500.0])
    states, info = jf.rollout(model, *both, 2e-3, 60)
    expected, _ = jf.rollout(*alone, 2e-3, 60)
    np.testing.assert_allclose(states.positions[:, : len(mesh.points)], expected.positions, atol=1e-10)
    plain, second = (float(jf.scheme_damping(scheme, 500.0, 2e-3)) for scheme in ("backward_euler", SCHEMES[0]))
    found = np.asarray(info.scheme_damping)[:, 0]
    assert np.isclose(found, plain).any() and np.isclose(found, second).sum() > 30


def test_rigid_bodies_are_refused_by_name():
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0)
    with pytest.raises(jf.SceneError, match="scenes with rigid bodies need"):
        jf.build(jf.Scene([ball]), scheme=SCHEMES[0])
