"""A joint kind that this file alone defines: its lock, its fields, its word in scene files, its mechanics."""

import functools
from dataclasses import field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.declared.errors import checked_direction
from jaxfem.declared.joints import JOINTS, Joint, Part, frame_along
from jaxfem.inputs import Direction, Vector, takes
from jaxfem.io import SceneFileError, load_scene
from jaxfem.pytrees import static
from jaxfem.rows.attachments import Frame, relative_spin
from jaxfem.rows.locks import JointRows, PointLock, spring_rows


class CrossLock(JointRows):
    """The third axes of frames `a` and `b` stay perpendicular: one row."""

    a: Frame
    b: Frame

    def rows(self, at, values, stage):
        """Gap: the cosine of their angle; d/dt (p . q) = (w_b - w_a) . (q x p)."""
        p, q = self.a.axes(at)[:, :, 2], self.b.axes(at)[:, :, 2]
        triples, spin = relative_spin(self.a, self.b, at)
        rate = jnp.einsum("mi,mik->mk", jnp.cross(q, p), spin)[:, None]
        return spring_rows(jnp.sum(p * q, -1, keepdims=True), triples, rate, values, at, stage)


class UniversalJoint(Joint, kind="universal"):
    """A cross (Hooke's joint) at `anchor`: its pins lie along `axis` in a and along `axis_b` in b, perpendicular."""

    anchor: Any = field(default=None, metadata=takes(Vector("m")))
    axis: Any = field(default=None, metadata=takes(Direction()))
    axis_b: Any = field(default=None, metadata=takes(Direction()))

    def __post_init__(self):
        super().__post_init__()
        pins = [checked_direction(f'{name} of "{self.label}"', getattr(self, name)) for name in ("axis", "axis_b")]
        if abs(np.dot(*pins)) > 1e-6:
            raise jf.SceneError(f'pins of "{self.label}" are not perpendicular: turn axis_b')

    def parts(self, bodies, where):
        """The pins' crossing, and their angle."""
        points = bodies.point(self.a, self.anchor, where), bodies.point(self.b, self.anchor, where)
        yield Part("point", PointLock(*points), self.softness)
        pins = (
            bodies.frame(self.a, frame_along(self.axis), where),
            bodies.frame(self.b, frame_along(self.axis_b), where),
        )
        yield Part("cross", CrossLock(*pins), self.softness)


BEND = 0.6  # between the shafts [rad]
SHAFT = np.array([np.cos(BEND), 0, np.sin(BEND)])  # of the driven one; the driving one lies along x
PIN = np.cross(SHAFT, (0, 1, 0))
RATE, STEP = 2 * np.pi, 2e-3
FILE = f"""
gravity = [0, 0, 0]
[time]
step = {STEP}
steps = 1
[[rigid]]
name = "driver"
shape = {{ sphere = 0.1 }}
mass = 1.0
position = [-0.5, 0, 0]
[[rigid]]
name = "driven"
shape = {{ sphere = 0.1 }}
mass = 2.0
position = {(0.5 * SHAFT).tolist()}
[[joint]]
kind = "hinge"
b = "driver"
anchor = [-0.5, 0, 0]
axis = [1, 0, 0]
motor = {{ target = {RATE}, strength = 1e3 }}
[[joint]]
kind = "hinge"
b = "driven"
anchor = {(0.5 * SHAFT).tolist()}
axis = {SHAFT.tolist()}
[[joint]]
kind = "universal"
name = "cardan"
a = "driver"
b = "driven"
anchor = [0, 0, 0]
axis = [0, 1, 0]
axis_b = {PIN.tolist()}
"""


def written(folder, text=FILE):
    path = folder / "shafts.toml"
    path.write_text(text)
    return path


def shafts():
    driver = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(-0.5, 0, 0), name="driver")
    driven = jf.RigidBody(jf.Sphere(0.1), mass=2.0, position=0.5 * SHAFT, name="driven")
    joints = [
        jf.HingeJoint(None, driver, (-0.5, 0, 0), (1, 0, 0), motor=jf.Motor(RATE, 1e3)),
        jf.HingeJoint(None, driven, 0.5 * SHAFT, SHAFT),
        UniversalJoint(driver, driven, (0, 0, 0), (0, 1, 0), PIN, name="cardan"),
    ]
    return jf.Scene([driver, driven], gravity=(0, 0, 0), joints=joints)


def angles(states):
    """How far the shafts have turned, each about its own axis [rad]."""
    turn = states.rigid.orientations
    return [2 * jnp.arctan2(turn[..., body, 1:] @ axis, turn[..., body, 0]) for body, axis in enumerate((X, SHAFT))]


X = np.array([1.0, 0, 0])


STEPS = 400


@functools.cache
def turned(factor):
    """The shafts' angles over time and the steps' status, at so many times the driving rate; the driven one's angle at
    the end, and its slope in the factor: one program for both tests."""
    return turning()(jnp.asarray(factor))


@functools.cache
def turning():
    model, params, state = jf.build(shafts(), tolerance=1e-13)
    name = "angle motor world-rigid"

    def driven_end(factor):
        motor = params.joints[name]
        joints = params.joints | {name: motor.replace(target=factor * motor.target)}
        states, info = jf.rollout(model, params.replace(joints=joints), state, STEP, STEPS)
        driver, driven = angles(states)
        return driven[-1], (driver, driven, info.status)

    return jax.jit(lambda factor: jax.jvp(driven_end, (factor,), (jnp.ones_like(factor),), has_aux=True))


def test_a_bent_shaft_turns_unevenly_by_the_law_of_the_universal_joint():
    """tan(driven) = cos(bend) tan(driver), to the order of (rate step)^2."""
    model, _, _ = jf.build(shafts())
    assert model.joints["cross rigid-rigid"].names == model.joints["point rigid-rigid"].names == ("cardan",)
    _, _, (driver, driven, status) = turned(1.0)
    assert not status.any()
    driver, driven = np.unwrap(driver), np.unwrap(driven)
    np.testing.assert_allclose(driver, RATE * STEP * np.arange(1, STEPS + 1), atol=1e-5)
    expected = np.unwrap(np.arctan2(np.cos(BEND) * np.sin(driver), np.cos(driver)))
    assert np.abs(expected - driver).max() > 0.09  # it is uneven
    np.testing.assert_allclose(driven, expected, atol=3e-4)


@pytest.mark.slow
def test_the_laws_derivative_in_the_driving_rate():
    _, slope, (driver, _, _) = turned(1.0)
    end = np.unwrap(driver)[-1]
    share = np.cos(BEND) / (np.cos(end) ** 2 + np.cos(BEND) ** 2 * np.sin(end) ** 2)
    assert float(slope) == pytest.approx(share * end, rel=5e-3)
    h = 1e-4
    ahead, back = (turned(1 + side * h)[0] for side in (1, -1))
    assert float(slope) == pytest.approx(float(ahead - back) / (2 * h), rel=1e-5)


def test_a_scene_file_knows_it(tmp_path):
    scene = load_scene(written(tmp_path)).scene
    assert type(scene.joints[2]) is UniversalJoint and scene.joints[2].axis == (0.0, 1.0, 0.0)
    here, there = (jf.build(each, tolerance=1e-12) for each in (shafts(), scene))
    assert jax.tree.structure(here) == jax.tree.structure(there)
    jax.tree.map(np.testing.assert_array_equal, here, there)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("axis_b", "axisb", r"unknown key 'axisb' in \[\[joint\]\] 3 \"cardan\" \(universal\): did you mean 'axis_b'"),
        (f"axis_b = {PIN.tolist()}", "", "missing key 'axis_b'"),
        (f"axis_b = {PIN.tolist()}", "axis_b = 3", "list of 3 finite numbers"),
        (f"axis_b = {PIN.tolist()}", "axis_b = [0, 1, 0]", "not perpendicular"),
        ('"universal"', '"univrsal"', "did you mean 'universal'"),
    ],
)
def test_mistakes_in_its_table_are_named(tmp_path, old, new, message):
    with pytest.raises((SceneFileError, jf.SceneError), match=message):
        load_scene(written(tmp_path, FILE.replace(old, new)))


def test_what_is_no_kind_of_its_own_is_refused_where_it_is_defined():
    def parts(self, bodies, where):
        yield from ()

    with pytest.raises(TypeError, match=r'calls itself joint kind "hinge", which jaxfem\..*HingeJoint is'):
        type("Pivot", (Joint,), {"parts": parts}, kind="hinge")
    with pytest.raises(TypeError, match="Empty does not say which rows"):
        type("Empty", (Joint,), {}, kind="empty")
    before = JOINTS.words()
    type("Base", (Joint,), {})
    assert JOINTS.words() == before and "empty" not in before


class LastSpin(JointRows):
    """No spin of the last body about z, whose triple of angular velocities is the last of all: -1, or its number."""

    a: Frame
    b: Frame
    triple: int = static()

    def rows(self, at, values, stage):
        """d/dt: the spin's own component; no gap is kept."""
        blocks = values.compliance.shape[0]
        rate = jnp.broadcast_to(jnp.array([0, 0, 1.0], at.centers.dtype), (blocks, 1, 3))
        triples = jnp.full((blocks, 1), self.triple)
        return spring_rows(jnp.zeros((blocks, 1), at.centers.dtype), triples, rate, values, at, stage)


class SpinJoint(Joint, kind="last spin"):
    """Of two bodies, the last does not turn about z."""

    triple: Any = -1

    def parts(self, bodies, where):
        """One part."""
        ends = (bodies.frame(end, frame_along((0, 0, 1.0)), where) for end in (self.a, self.b))
        yield Part("spin", LastSpin(*ends, self.triple), self.softness)


@pytest.mark.parametrize("solver", ["direct", "mprgp", "pgs"])
def test_triples_may_count_from_the_end(solver):
    ends = []
    for triple in (-1, 3):
        bodies = [
            jf.RigidBody(jf.Box((0.1, 0.2, 0.3)), mass=1.0, position=(x, 0, 0), angular_velocity=(0, 0, 2.0))
            for x in (0.0, 1.0)
        ]
        scene = jf.Scene(bodies, joints=[SpinJoint(*bodies, triple=triple)])
        state, info = jf.step(*jf.build(scene, solver=solver), dt=1e-2)
        assert info.status == 0
        ends.append(state.rigid.angular_velocities)
    np.testing.assert_array_equal(*ends)
    np.testing.assert_allclose(ends[0][:, 2], [2, 0], atol=1e-6)
