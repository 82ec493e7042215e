"""Contact and friction: closed forms, momentum, tunnelling, every kind of partner, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.rigid.dynamics import angular_momentum
from jaxfem.rows.triangles import nearest_triangle

NOTHING = (0.0, 0.0, 0.0)


def on_slope(degrees, **contact):
    """A cube at rest on a slope; model, params, state and the direction down it."""
    a = np.radians(degrees)
    normal, down = np.array([np.sin(a), 0, np.cos(a)]), np.array([np.cos(a), 0, -np.sin(a)])
    body = jf.RigidBody(
        jf.Box((0.2, 0.2, 0.2)), mass=1.0, position=0.1 * normal, orientation=(np.cos(a / 2), 0, np.sin(a / 2), 0)
    )
    plane = jf.Plane(NOTHING, normal)
    scene = jf.Scene([body], contacts=[jf.Contact(body, plane, **{"friction": 0.5, **contact})])
    return (*jf.build(scene, tolerance=1e-10), down)


def test_a_block_sticks_below_the_angle_of_friction_and_slides_above():
    model, params, state, _ = on_slope(26.5)
    (name,) = params.contacts
    for degrees in (26.5, 26.6, 35.0):
        own, values, start, down = on_slope(degrees)
        states, info = scenes.rolled(own, values, start, 1e-2, 50)
        assert not info.status.any()
        speed = float(states.rigid.velocities[-1, 0] @ down)
        a = np.radians(degrees)
        expected = max(0.0, 0.5 * 9.81 * (np.sin(a) - 0.5 * np.cos(a)))
        assert speed == pytest.approx(expected, rel=1e-6, abs=1e-8)
    slick = {name: params.contacts[name].replace(friction=0.0 * params.contacts[name].friction)}
    states, _ = scenes.rolled(model, params.replace(contacts=slick), state, 1e-2, 50)
    np.testing.assert_allclose(jnp.linalg.norm(states.rigid.velocities[-1, 0]), 4.905 * np.sin(np.radians(26.5)))


@pytest.mark.slow
def test_lanes_give_what_they_give_alone_and_single_precision_follows():
    model, params, state, down = on_slope(30.0)
    (name,) = params.contacts

    def speed(friction, model=model, params=params, state=state):
        contacts = {name: params.contacts[name].replace(friction=jnp.full(8, friction, state.time.dtype))}
        states, info = jf.rollout(model, params.replace(contacts=contacts), state, 1e-2, scenes.CHUNK)
        return states.rigid.velocities[-1, 0] @ jnp.asarray(down, state.time.dtype), info.status.max()

    values = jnp.array([0.0, 0.3, 0.7])
    lanes, status = jax.vmap(speed)(values)
    alone = [speed(each)[0] for each in values]
    np.testing.assert_allclose(lanes, alone, atol=1e-7)
    assert not status.any()
    single = jax.tree.map(lambda v: v.astype(jnp.float32) if v.dtype == jnp.float64 else v, (model, params, state))
    single = (single[0].replace(tolerance=jnp.float32(1e-4)), *single[1:])  # corners share to rounding alone
    follows = speed(jnp.float32(0.3), *single)
    assert follows[0].dtype == jnp.float32 and not follows[1]
    np.testing.assert_allclose(follows[0], alone[1], rtol=1e-3)


def test_a_ball_bounces_to_the_height_of_its_restitution_and_rolls():
    """Dropped by 1 m with e = 0.8 it rises to 0.64 m; a ball pushed along rough ground ends up rolling at 5/7 speed."""
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 1.1))
    pushed = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(1, 0, 0.1), velocity=(0, 2.0, 0))
    ground = [jf.Contact(ball, jf.Plane(), restitution=0.8), jf.Contact(pushed, jf.Plane(), friction=0.3)]
    model, params, state = jf.build(jf.Scene([ball, pushed], contacts=ground), tolerance=1e-10)
    states, info = jf.rollout(model, params, state, 1e-3, 900)
    assert not info.status.any()
    height = states.rigid.positions[:, 0, 2] - 0.1
    assert float(height.min()) > -1e-9
    assert float(height[460:].max()) == pytest.approx(0.64, rel=2e-3)
    np.testing.assert_allclose(states.rigid.velocities[-1, 1, 1], 2.0 * 5 / 7, rtol=1e-3)
    np.testing.assert_allclose(states.rigid.angular_velocities[-1, 1, 0], -2.0 * 5 / 7 / 0.1, rtol=1e-3)


@pytest.mark.parametrize("speed", [100.0])
def test_a_soft_body_does_not_tunnel_and_its_impulse_is_its_change_of_momentum(speed):
    mesh = jf.mesh.box((0.2, 0.2, 0.2), 1, tets_per_cell=5, origin=(0, 0, 0.5))
    body = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, damping=1e-3, velocity=(0, 0, -speed))
    contact = jf.Contact(body, jf.Plane(), friction=0.0)
    model, params, state = jf.build(jf.Scene([body], gravity=NOTHING, contacts=[contact]), tolerance=1e-10)
    states, info = jf.rollout(model, params, state, 1 / 60, 30)
    assert not info.status.any()
    assert float(states.positions[..., 2].min()) > -1e-6
    (name,) = model.contacts
    push = jnp.sum(jf.impulses(model, states)[f"contact {name}"], (1, 2))
    momentum = jnp.sum(1000.0 * model.nodal_volumes * states.velocities[..., 2], -1)
    before = jnp.concatenate([jnp.array([-8.0 * speed]), momentum[:-1]])
    np.testing.assert_allclose(momentum - before, push, atol=1e-8 * 8 * speed)
    assert push.max() > 8 * speed / 2


@pytest.mark.slow
def test_rigid_shapes_rest_on_one_another():
    """Six pairs side by side, the lower one fixed: where the upper ones come to rest."""
    pairs = [
        (jf.Sphere(0.1), jf.Box((1, 1, 0.2)), 0.2),
        (jf.Box((0.2, 0.2, 0.2)), jf.Box((1, 1, 0.2)), 0.2),
        (jf.Box((1.0, 1.0, 0.2)), jf.Box((0.2, 0.2, 0.2)), 0.2),  # larger than what it stands on
        (jf.Cylinder(0.1, 0.2), jf.Cylinder(0.5, 0.2), 0.2),
        (jf.Sphere(0.1), jf.Sphere(0.3), 0.4),
        (jf.Sphere(0.1), jf.Capsule(0.2, 0.5), 0.55),
    ]
    heights = np.array([height for _, _, height in pairs])
    tops, bottoms = [], []
    for k, (above, below, height) in enumerate(pairs):
        tops.append(jf.RigidBody(above, mass=1.0, position=(2.0 * k, 0, height + 0.02), name=f"top {k}"))
        bottoms.append(jf.RigidBody(below, mass=1.0, position=(2.0 * k, 0, 0), fixed=True, name=f"bottom {k}"))
    contacts = [jf.Contact(top, bottom) for top, bottom in zip(tops, bottoms, strict=True)]
    model, params, state = jf.build(jf.Scene([*tops, *bottoms], contacts=contacts), tolerance=1e-9)
    states, info = jf.rollout(model, params, state, 1e-2, 80)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, : len(pairs), 2], heights, atol=1e-4)
    np.testing.assert_allclose(states.rigid.velocities[-1, : len(pairs)], 0, atol=1e-4)


@pytest.mark.slow
def test_a_ball_named_second_does_not_fall_through_a_box():
    box = jf.RigidBody(jf.Box((1, 1, 0.2)), mass=1.0, fixed=True, name="box")
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0.1, 0, 0.22), name="ball")
    scene = jf.Scene([box, ball], contacts=[jf.Contact(box, ball)])
    model, params, state = jf.build(scene, tolerance=1e-9)
    assert set(model.contacts) == {"rough rigid-rigid sphere", "rough rigid-rigid box"}
    states, info = jf.rollout(model, params, state, 1e-2, 80)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, 1], (0.1, 0, 0.2), atol=1e-4)


@pytest.mark.slow
def test_colliding_rigid_bodies_keep_their_momentum():
    rng = np.random.default_rng(4)
    first = jf.RigidBody(jf.Box((0.2, 0.3, 0.2)), mass=1.0, velocity=(1.0, 0.1, 0), angular_velocity=rng.normal(size=3))
    second = jf.RigidBody(jf.Sphere(0.2), mass=3.0, position=(0.45, 0.05, 0.03), velocity=(-1.0, 0, 0))
    scene = jf.Scene([first, second], gravity=NOTHING, contacts=[jf.Contact(first, second, restitution=0.5)])
    model, params, state = jf.build(scene, tolerance=1e-13)
    states, _ = jf.rollout(model, params, state, 2e-3, 100)
    mass = params.rigid.mass[:, None]

    def momenta(rigid):
        linear = mass * rigid.velocities
        spin = angular_momentum(model.rigid, params.rigid.mass, rigid)
        return jnp.sum(linear, 0), jnp.sum(spin + jnp.cross(rigid.positions, linear), 0)

    linear, angular = jax.vmap(momenta)(states.rigid)
    start = momenta(state.rigid)
    assert abs(float(states.rigid.velocities[-1, 1, 0]) + 1.0) > 0.1  # they met
    assert jnp.abs(linear - start[0]).max() < 1e-13
    assert jnp.abs(angular - start[1]).max() < 1e-13


@pytest.mark.slow
def test_soft_balls_pass_their_momentum_on():
    """Newton's cradle of two soft balls: contact of surface nodes with the other's surface, momentum to rounding."""
    material = {"young": 1e6, "poisson": 0.3, "density": 1000.0}
    balls = [
        jf.SoftBody(jf.mesh.ball(0.1, 1, (x, 0, 0), name=name), velocity=v, **material)
        for x, name, v in ((0.0, "left", (2.0, 0, 0)), (0.21, "right", NOTHING))
    ]
    contact = jf.Contact(balls[0], balls[1], friction=0.0)
    model, params, state = jf.build(jf.Scene(balls, gravity=NOTHING, contacts=[contact]), tolerance=1e-10)
    states, info = jf.rollout(model, params, state, 2e-3, 30)
    assert not info.status.any()
    nodal = 1000.0 * model.nodal_volumes[:, None]
    total = jnp.sum(nodal * states.velocities, 1)
    start = jnp.sum(nodal * state.velocities, 0)
    np.testing.assert_allclose(total, np.tile(start, (30, 1)), atol=1e-12 * float(start[0]))
    right = np.asarray(model.body_nodes("right"))
    moved = float(jnp.sum((nodal * states.velocities[-1])[right, 0]))
    assert moved > 0.55 * float(start[0])


def test_nearest_triangle_is_that_of_the_mesh():
    mesh = jf.mesh.ball(0.1, 2)
    points = np.random.default_rng(0).normal(size=(20, 3))
    points *= 0.13 / np.linalg.norm(points, axis=1, keepdims=True)
    triangles = jnp.broadcast_to(jnp.asarray(mesh.surface), (len(points), *mesh.surface.shape))
    chosen, weights, normal = nearest_triangle(jnp.asarray(points), jnp.asarray(mesh.points), triangles)
    foot = np.einsum("mk,mki->mi", weights, mesh.points[np.asarray(chosen)])
    dense = mesh.points[mesh.surface].mean(1)
    assert (
        np.linalg.norm(foot - points, axis=1) <= np.linalg.norm(dense[None] - points[:, None], axis=-1).min(1)
    ).all()
    assert (np.einsum("mi,mi->m", normal, points) > 0.1).all()


def test_rounding_does_not_choose_between_triangles_that_are_as_near():
    """Points beyond the edges and corners that a ball's triangles share, each moved by less than a picometre."""
    mesh, rng = jf.mesh.ball(0.1, 2), np.random.default_rng(1)
    corners = mesh.points[mesh.surface]
    points = 1.2 * np.concatenate([corners.reshape(-1, 3), 0.5 * (corners[:, 0] + corners[:, 1])])
    triangles = jnp.broadcast_to(jnp.asarray(mesh.surface), (len(points), *mesh.surface.shape))
    find = jax.jit(nearest_triangle)
    moved = [points + rng.uniform(-1e-14, 1e-14, points.shape) for _ in range(3)]
    normals = [find(jnp.asarray(each), jnp.asarray(mesh.points), triangles)[2] for each in moved]
    for normal in normals[1:]:
        np.testing.assert_allclose(normal, normals[0], atol=1e-12)


@pytest.mark.slow
def test_ground_of_other_kinds_carries_a_soft_block():
    def bowl(point, radius):
        return radius - jnp.linalg.norm(point - jnp.array([0.0, 0.0, radius]))

    for ground in (jf.HeightField(np.zeros((3, 3)), (1.0, 1.0), (-1.0, -1.0)), jf.SignedDistance(bowl, 2.0)):
        mesh = jf.mesh.box((0.2, 0.2, 0.1), 1, origin=(-0.1, -0.1, 0.02))
        body = jf.SoftBody(mesh, young=1e5, poisson=0.3, density=1000.0, damping=0.02)
        scene = jf.Scene([body], contacts=[jf.Contact(body, ground)])
        model, params, state = jf.build(scene, tolerance=1e-8)
        states, info = jf.rollout(model, params, state, 1e-2, 60)
        assert not info.status.any()
        gaps = jax.vmap(ground.distance)(states.positions[-1])
        assert float(gaps.min()) == pytest.approx(0, abs=1e-6)
        assert float(jnp.abs(states.velocities[-1]).max()) < 1e-3
        (name,) = model.contacts
        carried = jnp.sum(jf.impulses(model, states)[f"contact {name}"][-1]) / 1e-2
        assert float(carried) == pytest.approx(9.81 * 4.0, rel=0.02)  # in the bowl, normals lean


def test_derivative_of_a_sliding_distance_in_friction_and_mass():
    model, params, state, down = on_slope(0.0)
    model = model.replace(tolerance=jnp.asarray(1e-13))
    (name,) = params.contacts
    moving = state.rigid.replace(velocities=jnp.array([[1.0, 0.3, 0.0]]))

    def distance(friction, speed):
        contacts = {name: params.contacts[name].replace(friction=friction * params.contacts[name].friction)}
        start = state.replace(rigid=moving.replace(velocities=speed * moving.velocities))
        states, _ = jf.rollout(model, params.replace(contacts=contacts), start, 1e-2, 8)
        return states.rigid.positions[-1, 0] @ jnp.asarray(down)

    derivatives.check(distance, (1.0, 1.0))


@pytest.mark.slow
def test_derivative_of_a_soft_bounce_in_its_stiffness():
    mesh = jf.mesh.box((0.1, 0.1, 0.1), 1, tets_per_cell=5, origin=(0, 0, 0.01))
    body = jf.SoftBody(mesh, young=2e4, poisson=0.3, density=1000.0, damping=2e-3, velocity=(0.3, 0, -2.0))
    scene = jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=0.3)])
    model, params, state = jf.build(scene, tolerance=1e-13)

    def height(young, poisson, damping):
        values = params.replace(
            young=young * params.young, poisson=poisson * params.poisson, damping=damping * params.damping
        )
        states, _ = jf.rollout(model, values, state, 5e-3, 12)
        return jnp.mean(states.positions[-1] @ jnp.array([0.2, 0.0, 1.0]))

    derivatives.check(height, (1.0, 1.0, 1.0), forwards=False)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda s, r: jf.Contact(s, None), "needs two partners"),
        (lambda s, r: jf.Contact(s, jf.Plane(), friction=-1), "at least 0"),
        (lambda s, r: jf.Contact(s, jf.Plane(), restitution=2), "at most 1"),
        (lambda s, r: jf.Contact(r, s), "soft body first"),
        (lambda s, r: jf.Contact(r, r), "one body twice"),
        (lambda s, r: jf.Contact(r, jf.Plane(), nodes=[0]), "belong to a soft body"),
        (lambda s, r: jf.Contact(s, "floor"), 'names "floor"'),
        (lambda s, r: jf.Plane(), "holds a Plane"),
    ],
)
def test_impossible_contacts_are_refused(make, text):
    soft = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), young=1e5, poisson=0.3, density=1e3, name="soft")
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, name="ball")
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([soft, ball], contacts=[make(soft, ball)]))
