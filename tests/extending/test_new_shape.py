"""A contact shape that this file alone defines: a cone, as ground, as a rigid body, and in scene files."""

from dataclasses import field
from typing import Any

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest

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


@pytest.mark.parametrize(("hill", "label"), [("ground", "rigid-ground cone"), ("body", "rigid-rigid cone")])
def test_a_ball_rolls_down_a_cone_without_slipping(hill, label):
    """Five sevenths of g sin(slope), 2/5 of the mass being in the spin; t (t + dt) / 2 as backward Euler has it."""
    model, params, state = jf.build(rolling(hill), tolerance=1e-12)
    assert list(model.contacts) == [f"rough {label}"]
    dt, steps = 5e-3, 60
    states, info = jf.rollout(model, params, state, dt, steps)
    assert not info.status.any()
    start, down = on_side(HILL[1])
    way = states.rigid.positions[:, 0] - start
    t = dt * np.arange(1, steps + 1)
    sine = HILL[1] / np.hypot(*HILL)
    np.testing.assert_allclose(way @ down, 5 / 7 * 9.81 * sine * t * (t + dt) / 2, rtol=2e-3, atol=1e-7)
    np.testing.assert_allclose(way - (way @ down)[:, None] * down, 0, atol=1e-6)
    np.testing.assert_allclose(
        states.rigid.angular_velocities[-1, 0], [0, BALL**-1 * 5 / 7 * 9.81 * sine * t[-1], 0], rtol=2e-3, atol=1e-6
    )


def test_the_way_down_has_its_derivative_in_the_height_of_the_hill():
    model, params, state = jf.build(rolling("ground"), tolerance=1e-13)
    (label,) = model.contacts
    candidates = model.contacts[label]

    def way(height):
        start, down = on_side(height)
        hill = candidates.shape.replace(height=height * jnp.ones_like(candidates.shape.height))
        moved = model.replace(contacts={label: candidates.replace(shape=hill)})
        rigid = state.rigid.replace(positions=start[None])
        states, _ = jf.rollout(moved, params, state.replace(rigid=rigid), 1e-2, 20)
        return (states.rigid.positions[-1, 0] - start) @ down

    derivatives.check(way, (HILL[1],))
    share = HILL[0] ** 2 / np.hypot(*HILL) ** 3  # of the sine of the slope
    assert float(jax.grad(way)(HILL[1])) == pytest.approx(5 / 7 * 9.81 * share * 0.2 * 0.21 / 2, rel=2e-3)


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
    with pytest.raises(jf.SceneError, match="has a TriangleMesh for ground; ground is one of"):
        jf.Contact("a", jf.TriangleMesh([[0, 0, 0]], [[0, 0, 0]]))


def test_what_is_no_shape_is_refused_where_it_is_defined():
    with pytest.raises(TypeError, match=r'calls itself shape "box", which jaxfem\..*Box is'):
        type("Crate", (Shape,), {"__annotations__": {}, "distance": lambda self, p: p[0], "read": READ}, word="box")
    with pytest.raises(TypeError, match="neither `distance` nor"):
        type("Nothing", (Shape,), {}, word="nothing")
    with pytest.raises(TypeError, match="says not what its fields take"):
        type("Half", (Shape,), {"distance": lambda self, p: p[2]}, word="half")
    assert not {"nothing", "half"} & set(SHAPES.words())


READ = classmethod(lambda cls, table, sources: cls())
