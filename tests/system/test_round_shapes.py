"""Round bodies touch with whichever of their points is nearest: gaps, rolling, rest on what they lie across."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.system.coupled import configuration

LYING = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # axis along x
ASIDE = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # axis along y
DISC, ROD, BLOCK, PILL = jf.Cylinder(0.3, 0.5), jf.Cylinder(0.2, 1.0), jf.Box((0.4, 0.6, 0.8)), jf.Capsule(0.15, 0.5)


def surface(shape, count=60):
    """Points (k, 3) all over a solid's surface."""
    if isinstance(shape, jf.Box):
        line = np.linspace(-0.5, 0.5, count)
        grid = np.stack(np.meshgrid(line, line, indexing="ij"), -1).reshape(-1, 2)
        sides = [np.insert(grid, axis, side, axis=1) for axis in range(3) for side in (-0.5, 0.5)]
        return np.concatenate(sides) * np.asarray(shape.size)
    r, half = shape.radius, shape.length / 2
    if isinstance(shape, jf.Capsule):
        turn = np.linspace(0, np.pi / 2, count)
        cap = np.stack([r * np.sin(turn), half + r * np.cos(turn)], -1)
    else:
        cap = np.stack([np.linspace(0, r, count), np.full(count, half)], -1)
    side = np.stack([np.full(count, r), np.linspace(half, -half, count)], -1)
    profile = np.concatenate([cap, side, cap * (1, -1)])
    turn = np.linspace(0, 2 * np.pi, 4 * count, endpoint=False)
    rings = [
        np.outer(np.cos(turn), (1, 0, 0)) * x + np.outer(np.sin(turn), (0, 1, 0)) * x + (0, 0, z) for x, z in profile
    ]
    return np.concatenate(rings)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        pytest.param(DISC, BLOCK, marks=pytest.mark.slow),
        (ROD, DISC),
        pytest.param(PILL, BLOCK, marks=pytest.mark.slow),
        pytest.param(PILL, jf.Capsule(0.1, 1.0), marks=pytest.mark.slow),
        pytest.param(BLOCK, PILL, marks=pytest.mark.slow),
        pytest.param(PILL, DISC, marks=pytest.mark.slow),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_the_least_gap_is_the_distance_of_the_solids(one, other):
    """From points all over the first one's surface; those miss the nearest by a little, and only upwards."""
    a, b = jf.RigidBody(one, mass=1.0, name="a"), jf.RigidBody(other, mass=1.0, name="b")
    model, _, state = jf.build(jf.Scene([a, b], contacts=[jf.Contact(a, b)]), solver="mprgp")
    points = jnp.asarray(surface(one))
    rng = np.random.default_rng(5)
    places = rng.normal(size=(60, 3))
    places *= rng.uniform(0.4, 1.1, (60, 1)) / np.linalg.norm(places, axis=1, keepdims=True)
    turns = rng.normal(size=(60, 4))
    turns[::3] = LYING
    turns[1::6] = 1, 0, 0, 0
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)

    @jax.jit
    @jax.vmap
    def gaps(place, turn):
        rigid = state.rigid.replace(
            positions=state.rigid.positions.at[0].set(place), orientations=state.rigid.orientations.at[0].set(turn)
        )
        at = configuration(state.replace(rigid=rigid))
        least = jnp.stack([group.pairs(at).gap.min() for group in model.contacts.values()]).min()
        return least, jax.vmap(other.distance)(points @ at.rotations[0].T + place).min()

    found, sampled = map(np.asarray, gaps(jnp.asarray(places), jnp.asarray(turns)))
    apart = sampled > 1e-3
    assert apart.sum() > 20
    assert (found - sampled)[apart].max() < 5e-5  # of two places on a rim that are as near, either will do
    assert (found - sampled)[apart].min() > -6e-3  # of a spacing up to 1.7e-2


@pytest.mark.parametrize("dt", [1e-2, 1 / 240])
def test_lying_round_bodies_roll_down_a_slope_as_they_must(dt):
    """Without sliding: g sin(a) / (1 + I / m r^2), two thirds of g sin(a) for a cylinder."""
    slope, radius = 0.3, 0.1
    shapes = (jf.Cylinder(radius, 0.3), jf.Capsule(radius, 0.2))
    turn = (np.cos(slope / 2), 0, np.sin(slope / 2), 0)
    normal = np.array([np.sin(slope), 0, np.cos(slope)])
    half = np.sqrt(0.5)  # the turn that lays it down, then the slope's
    laid = (half * turn[0], half * turn[0], half * turn[2], -half * turn[2])
    bodies = [
        jf.RigidBody(shape, mass=1.0, position=radius * normal + (0, y, 0), orientation=laid)
        for y, shape in enumerate(shapes)
    ]
    ground = jf.Plane(normal=tuple(normal))
    contacts = [jf.Contact(body, ground, friction=0.9) for body in bodies]
    model, params, state = jf.build(jf.Scene(bodies, contacts=contacts), tolerance=1e-11)
    states, info = jf.rollout(model, params, state, dt, 50)
    assert not info.status.any()
    down = np.array([np.cos(slope), 0, -np.sin(slope)])
    share = [1 / (1 + shape.mass_properties()[2][2, 2] / radius**2) for shape in shapes]
    assert share[0] == pytest.approx(2 / 3)
    expected = 9.81 * np.sin(slope) * dt * 50 * np.array(share)
    np.testing.assert_allclose(states.rigid.velocities[-1] @ down, expected, rtol=1e-6)
    np.testing.assert_allclose(states.rigid.positions[..., [0, 2]] @ normal[[0, 2]], radius, atol=1e-6)


ACROSS = [  # above, its turn and place, below (fixed), its turn, height of the upper one at rest
    (jf.Cylinder(0.1, 1.0), LYING, (0.02, 0), jf.Box((0.2, 0.5, 0.2)), None, 0.2),
    (jf.Capsule(0.1, 1.0), LYING, (0.02, 0), jf.Box((0.2, 0.5, 0.2)), None, 0.2),
    (jf.Capsule(0.05, 0.2), LYING, (0, 0), jf.Capsule(0.3, 0.6), LYING, 0.35),  # shorter, along it: kept by friction
    (jf.Capsule(0.05, 0.4), LYING, (0.002, 0), jf.Capsule(0.2, 0.6), ASIDE, 0.25),
    (jf.Cylinder(0.05, 0.4), LYING, (0.002, 0), jf.Cylinder(0.2, 0.6), ASIDE, 0.25),
    (jf.Box((0.6, 0.2, 0.1)), None, (0.002, 0), jf.Cylinder(0.2, 0.6), ASIDE, 0.25),
    (jf.Box((0.6, 0.2, 0.1)), None, (0.002, 0), jf.Capsule(0.2, 0.6), ASIDE, 0.25),
    (jf.Cylinder(0.2, 0.1), None, (0.06, 0.1), jf.Box((0.3, 1.0, 0.2)), None, 0.15),  # standing, partly over the edge
    (jf.Cylinder(0.2, 0.1), None, (0.1, 0.1), jf.Cylinder(0.2, 0.2), None, 0.15),
    (jf.Box((0.6, 0.6, 0.1)), None, (0.05, 0.02), jf.Cylinder(0.2, 0.2), None, 0.15),
    (jf.Capsule(0.1, 1.0), LYING, (0.02, 0), jf.Cylinder(0.2, 0.2), None, 0.2),
]


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_bodies_rest_on_what_they_lie_across(dtype):
    heights = np.array([each[-1] for each in ACROSS])
    tops, bottoms = [], []
    for k, (above, turn, (x, y), below, other, height) in enumerate(ACROSS):
        place, start = (2.0 * k + x, y, height + 0.002), turn or (1, 0, 0, 0)
        tops.append(jf.RigidBody(above, mass=1.0, position=place, orientation=start, name=f"top {k}"))
        under = other or (1, 0, 0, 0)
        bottoms.append(
            jf.RigidBody(below, mass=1.0, position=(2.0 * k, 0, 0), orientation=under, fixed=True, name=f"base {k}")
        )
    contacts = [jf.Contact(top, bottom) for top, bottom in zip(tops, bottoms, strict=True)]
    single = dtype == jnp.float32
    model, params, state = jf.build(
        jf.Scene([*tops, *bottoms], contacts=contacts), tolerance=1e-4 if single else 1e-7, dtype=dtype, solver="mprgp"
    )
    states, info = scenes.rolled(model, params, state, 1e-2, 80)
    assert not info.status.any()
    end, start = states.rigid, state.rigid
    count = len(ACROSS)
    np.testing.assert_allclose(end.positions[-1, :count, 2], heights, atol=2e-3 if single else 2e-4)
    np.testing.assert_allclose(end.positions[-1, :count, :2], start.positions[:count, :2], atol=2e-3)
    np.testing.assert_allclose(end.velocities[-1, :count], 0, atol=1e-2)  # some rock, 2 mm off their balance


@pytest.mark.slow
def test_a_tilted_cylinder_falls_on_its_end_and_stands():
    a = 0.05
    body = jf.RigidBody(
        jf.Cylinder(0.1, 0.1), mass=1.0, position=(0, 0, 0.07), orientation=(np.cos(a), np.sin(a), 0, 0)
    )
    scene = jf.Scene([body], contacts=[jf.Contact(body, jf.Plane())])
    states, info = scenes.rolled(*jf.build(scene, tolerance=1e-10), 5e-3, 100)
    assert not info.status.any()
    assert float(states.rigid.positions[:, 0, 2].min()) > 0.05 - 1e-4
    np.testing.assert_allclose(states.rigid.positions[-1, 0, 2], 0.05, atol=1e-5)
    np.testing.assert_allclose(states.rigid.velocities[-1, 0], 0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape",
    [pytest.param(jf.Capsule(0.1, 0.6), id="sides"), pytest.param(jf.Cylinder(0.1, 0.6), id="rims")],
)
def test_derivative_of_an_impact_of_round_bodies(shape):
    """The capsule strikes across another one; the cylinder's rim strikes a face."""
    pill = isinstance(shape, jf.Capsule)
    below = jf.RigidBody(
        jf.Capsule(0.1, 1.0) if pill else jf.Box((2, 2, 0.2)),
        mass=1.0,
        fixed=True,
        orientation=LYING if pill else (1, 0, 0, 0),
    )
    above = jf.RigidBody(shape, mass=2.0, position=(0.05, 0.02, 0.25), orientation=ASIDE)
    scene = jf.Scene([above, below], contacts=[jf.Contact(above, below, friction=0.02)])
    model, params, state = jf.build(scene, tolerance=1e-13, solver="mprgp")
    turn = np.array([0.70, 0.66, 0.1, 0.2])

    def place(friction, speed, height):
        rigid = state.rigid.replace(
            orientations=state.rigid.orientations.at[0].set(turn / np.linalg.norm(turn)),
            velocities=state.rigid.velocities.at[0].set(jnp.array([0.2, 0.1, -2.0]) * speed),
            positions=state.rigid.positions.at[0, 2].set((0.22 if pill else 0.235) * height),
        )
        contacts = {
            name: values.replace(friction=friction * values.friction) for name, values in params.contacts.items()
        }
        states, _ = jf.rollout(model, params.replace(contacts=contacts), state.replace(rigid=rigid), 5e-3, 6)
        return states.rigid.positions[-1, 0] @ jnp.array([1.0, 0.5, 0.3]) + states.rigid.angular_velocities[-1, 0, 1]

    derivatives.check(place, (1.0, 1.0, 1.0), forwards=not pill)
