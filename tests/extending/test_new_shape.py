"""A contact shape that this file alone defines: a cone, as ground, as a rigid body, and in scene files."""

import functools
from dataclasses import field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import Parted

import jaxfem as jf
from jaxfem.inputs import Number, takes
from jaxfem.io import SceneFileError, load_scene
from jaxfem.rigid.shapes import SHAPES, Shape
from jaxfem.rigid.shapes.base import length


class Cone(Shape, word="cone"):
    """A cone about z: a base of `radius` [m] at z = 0 and an apex at z = `height` [m]."""

    radius: Any = field(metadata=takes(Number("m", positive=True)))
    height: Any = field(metadata=takes(Number("m", positive=True)))

    def mass_properties(self):
        """Its centre of mass is a quarter of its height above the base."""
        r, h = float(self.radius), float(self.height)
        across = 3 / 20 * r**2 + 3 / 80 * h**2
        return np.pi * r**2 * h / 3, np.array([0, 0, h / 4]), np.diag([across, across, 0.3 * r**2])

    def distance(self, point):
        """To the side, the base, or the nearer of rim and apex."""
        r, h = self.radius, self.height
        out, up = length(point[:2]), point[2]
        side = jnp.sqrt(r**2 + h**2)
        off, along = ((out - r) * h + up * r) / side, ((r - out) * r + up * h) / side
        corner = jnp.minimum(length(jnp.stack([out - r, up])), length(jnp.stack([out, up - h])))
        beneath = jnp.where((up <= 0) & (out <= r), -up, corner)
        outside = jnp.where((off >= 0) & (along >= 0) & (along <= side), off, beneath)
        return jnp.where((off < 0) & (up > 0), jnp.maximum(off, -up), outside)

    def features(self):
        """Apex and twelve points of the rim."""
        turn = np.arange(12) * np.pi / 6
        rim = float(self.radius) * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
        return np.concatenate([[[0, 0, float(self.height)]], rim]), np.zeros(13)


HILL = (2.0, 0.5)  # radius and height
BALL = 0.1


def on_side(height):
    """A ball's centre where it lies on the hill's side half way down, for a hill of that height; and the way down."""
    r = HILL[0]
    side = jnp.sqrt(r**2 + height**2)
    outward = jnp.stack([height / side, 0 * side, r / side])
    return jnp.stack([0.5 * r + 0 * height, 0 * height, 0.5 * height]) + BALL * outward, jnp.stack(
        [r / side, 0 * side, -height / side]
    )


def rolling(hill):
    """A ball on the side of a hill: ground, or a rigid body that is fixed."""
    place, _ = on_side(jnp.asarray(HILL[1]))
    ball = jf.RigidBody(jf.Sphere(BALL), mass=1.0, position=np.asarray(place), name="ball")
    if hill == "ground":
        return jf.Scene([ball], contacts=[jf.Contact(ball, Cone(*HILL))])
    body = jf.RigidBody(Cone(*HILL), mass=1.0, fixed=True, name="hill")
    return jf.Scene([ball, body], contacts=[jf.Contact(ball, body)])


DT, STEPS = 5e-3, 40
TIME = DT * np.arange(1, STEPS + 1)
SINE = HILL[1] / np.hypot(*HILL)  # of the slope


def check_rolling(way, spin):
    """Five sevenths of g sin(slope), 2/5 of the mass being in the spin; t (t + dt) / 2 as backward Euler has it."""
    down = np.asarray(on_side(HILL[1])[1])
    np.testing.assert_allclose(way @ down, 5 / 7 * 9.81 * SINE * TIME * (TIME + DT) / 2, rtol=2e-3, atol=1e-7)
    np.testing.assert_allclose(way - (way @ down)[:, None] * down, 0, atol=1e-6)
    np.testing.assert_allclose(spin[-1], [0, 5 / 7 * 9.81 * SINE * TIME[-1] / BALL, 0], rtol=2e-3, atol=1e-6)


def test_a_ball_rolls_down_a_rigid_cone_whose_centre_of_mass_is_not_its_origin():
    model, params, state = jf.build(rolling("body"), tolerance=1e-12)
    assert list(model.contacts) == ["rough rigid-rigid cone"]
    states, info = jf.rollout(model, params, state, DT, STEPS)
    assert not info.status.any()
    check_rolling(states.rigid.positions[:, 0] - on_side(HILL[1])[0], states.rigid.angular_velocities[:, 0])


@pytest.mark.slow
def test_a_ball_rolls_down_ground_and_its_way_has_a_derivative_in_the_height_of_the_hill():
    model, params, state = jf.build(rolling("ground"), tolerance=1e-13)
    (label,) = model.contacts
    assert label == "rough rigid-ground cone"
    candidates = model.contacts[label]

    @functools.partial(Parted, has_aux=True)
    def way(height):
        start, down = on_side(height)
        hill = candidates.shape.replace(height=height * jnp.ones_like(candidates.shape.height))
        moved = model.replace(contacts={label: candidates.replace(shape=hill)})
        rigid = state.rigid.replace(positions=start[None])
        states, info = jf.rollout(moved, params, state.replace(rigid=rigid), DT, STEPS)
        path = states.rigid.positions[:, 0] - start
        return path[-1] @ down, (path, states.rigid.angular_velocities[:, 0], info.status)

    (_, (path, spin, status)), (slope,) = way(HILL[1]), way.backwards(HILL[1])
    assert not status.any()
    check_rolling(path, spin)
    share = HILL[0] ** 2 / np.hypot(*HILL) ** 3  # derivative of the sine of the slope
    expected = 5 / 7 * 9.81 * share * TIME[-1] * (TIME[-1] + DT) / 2
    assert float(slope) == pytest.approx(expected, rel=2e-3)
    h = 1e-4
    central = (way(HILL[1] + h)[0] - way(HILL[1] - h)[0]) / (2 * h)
    assert float(slope) == pytest.approx(float(central), rel=1e-5)


class Needle(Shape):
    """A point that touches others and has no distance."""

    def mass_properties(self):
        """Of a small ball."""
        return 1e-9, np.zeros(3), 1e-6 * np.eye(3)

    def features(self):
        """Its tip."""
        return np.zeros((1, 3)), np.zeros(1)


FILE = """
[time]
step = 0.01
steps = 1
[[rigid]]
name = "cone"
shape = { cone = 0.2, height = 0.4 }
density = 500.0
position = [0, 0, 0.01]
[[contact]]
a = "cone"
ground = { plane = [0, 0, 1] }
[[rigid]]
name = "ball"
shape = { sphere = 0.1 }
mass = 1.0
position = [5, 0, 0]
[[contact]]
a = "ball"
ground = { cone = 2.0, height = 0.5 }
"""


def written(folder, text=FILE):
    path = folder / "cones.toml"
    path.write_text(text)
    return path


def test_a_cone_of_a_scene_file_falls_on_its_base_and_rests(tmp_path):
    scene = load_scene(written(tmp_path)).scene
    cone, hill = scene.rigid[0], scene.contacts[1].b
    assert isinstance(cone.shape, Cone) and isinstance(hill, Cone) and (hill.radius, hill.height) == HILL
    assert cone.properties[0] == pytest.approx(500 * np.pi * 0.04 * 0.4 / 3)
    model, params, state = jf.build(jf.Scene([cone], contacts=scene.contacts[:1]), tolerance=1e-12)
    states, info = jf.rollout(model, params, state, 1e-2, 40)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, 0], [0, 0, 0.1], atol=1e-6)
    np.testing.assert_allclose(states.rigid.orientations[-1, 0], [1, 0, 0, 0], atol=1e-6)


def test_its_moments_and_distance_agree():
    """Over where the distance is negative: volume, centre and inertia; outside, its gradient leads to the surface."""
    cone = Cone(0.4, 0.5)
    step = 0.01
    axis = np.arange(-0.5 + step / 2, 0.6, step)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    value, normal = jax.vmap(jax.value_and_grad(cone.distance))(jnp.asarray(grid))
    inside = grid[np.asarray(value) < 0]
    volume, center, inertia = cone.mass_properties()
    second = (inside - center).T @ (inside - center) / len(inside)
    np.testing.assert_allclose(len(inside) * step**3, volume, rtol=0.01)
    np.testing.assert_allclose(inside.mean(0), center, atol=1e-3)
    np.testing.assert_allclose(np.trace(second) * np.eye(3) - second, inertia, rtol=0.02, atol=1e-5)
    foot = (jnp.asarray(grid) - value[:, None] * normal)[value > 0.02]
    assert jnp.abs(jax.vmap(cone.distance)(foot)).max() < 1e-12


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("cone = 0.2, height", "cone = 0.2, heigt", r"unknown key 'heigt' in 'shape' .* \(a cone\): did you mean"),
        ("cone = 0.2", "con = 0.2", "unknown key 'con' in 'shape' .*: did you mean 'cone'"),
        ("cone = 0.2", "cone = -0.2", "must be a positive number of m"),
        (", height = 0.4", "", "missing key 'height'"),
        ("cone = 0.2", "plane = 0.2", "unknown key 'plane' in 'shape'"),
    ],
)
def test_mistakes_in_its_table_are_named(tmp_path, old, new, message):
    with pytest.raises((SceneFileError, jf.SceneError), match=message):
        load_scene(written(tmp_path, FILE.replace(old, new)))


def test_mistakes_in_python_are_named():
    with pytest.raises(jf.SceneError, match=r'height of "cone" is -1\.0; lengths must be positive'):
        jf.RigidBody(Cone(1.0, -1.0), mass=1.0)
    with pytest.raises(jf.SceneError, match=r"a rigid body is one of .*, Cone"):
        jf.RigidBody(jf.Plane(), mass=1.0)
    with pytest.raises(jf.SceneError, match="has a Needle for ground; ground is one of"):
        jf.Contact("a", Needle())


def test_partners_that_cannot_meet_are_refused():
    needle = jf.RigidBody(Needle(), mass=1.0, name="needle")
    other = jf.RigidBody(Needle(), mass=1.0, name="other")
    with pytest.raises(jf.SceneError, match=r'"other" is a Needle, which .* no distance; give the shape one'):
        jf.build(jf.Scene([needle, other], contacts=[jf.Contact(needle, other)]))
    none = type("Air", (Needle,), {"features": lambda self: (np.zeros((0, 3)), np.zeros(0)), "distance": Cone.distance})
    air = jf.RigidBody(none(), mass=1.0, inertia=np.eye(3), name="air")
    with pytest.raises(jf.SceneError, match=r"nothing that could meet, .* TriangleMesh in its place"):
        jf.build(jf.Scene([air], contacts=[jf.Contact(air, jf.Plane(), margin=0.1)]))


def test_what_is_no_shape_is_refused_where_it_is_defined():
    with pytest.raises(TypeError, match=r'calls itself shape "box", which jaxfem\..*Box is'):
        type("Crate", (Shape,), {"__annotations__": {}, "distance": lambda self, p: p[0], "read": READ}, word="box")
    with pytest.raises(TypeError, match="neither `distance` nor"):
        type("Nothing", (Shape,), {}, word="nothing")
    with pytest.raises(TypeError, match="says not what its fields take"):
        type("Half", (Shape,), {"distance": lambda self, p: p[2]}, word="half")
    assert not {"nothing", "half"} & set(SHAPES.words())


READ = classmethod(lambda cls, table, sources: cls())
