"""Contact shapes of one's own that answer what they cannot are refused in `build`, by name and with what to do."""

from dataclasses import field
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.inputs import Flag, Number, takes
from jaxfem.pytrees import static
from jaxfem.rigid.shapes import Shape

BALL = jf.RigidBody(jf.Sphere(0.1), mass=1.0, name="ball")
OTHER = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(1, 0, 0), name="other")


class Floor(Shape, word="floor_of_a_test"):
    """Level ground, which a flag turns into a ceiling; `sides` is part of the program."""

    height: Any = field(metadata=takes(Number("m")))
    ceiling: Any = field(default=False, metadata=takes(Flag()))
    sides: int = static(default=4)

    def distance(self, point):
        up = point[2] - self.height
        return jnp.where(self.ceiling, -up, up)


def test_a_shape_has_flags_and_each_contact_its_own_static_fields():
    contacts = [
        jf.Contact(BALL, Floor(-0.1)),
        jf.Contact(BALL, Floor(0.4, True)),
        jf.Contact(OTHER, Floor(-0.1, sides=5)),
    ]
    model, params, state = jf.build(jf.Scene([BALL, OTHER], contacts=contacts))
    assert list(model.contacts) == ["rough rigid-ground floor", "rough rigid-ground floor 2"]
    first = model.contacts["rough rigid-ground floor"]
    assert first.shape.ceiling.dtype == bool and first.names == ("0", "1")
    states, info = jf.rollout(model, params, state, 1e-2, 3)
    assert not info.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, 0, 2], 0, atol=1e-6)


@pytest.mark.parametrize(
    ("hook", "answer", "text"),
    [
        ("distance", lambda self, point: point[2:], r"touches a Wrong: `distance` gives an array of shape \(1,\)"),
        ("distance", lambda self, point: None, "`distance` gives None for a point"),
        ("distance", lambda self, point: point[2] > 0, "`distance` gives an array of shape .* and type bool"),
        (
            "distance",
            lambda self, point: point[2].astype(int),
            "type int64 .* it must give one number",
        ),
        ("distance", lambda self, point: 1, "`distance` gives 1 for a point"),
        ("distance", lambda self, point: point[2].astype(np.float32), "type float32 .* of the type float64"),
        ("measured", lambda self, reach=0.0: None, "`measured` gives None; it must give a pytree of arrays with"),
        ("measured", lambda self, reach=0.0: type("Own", (), {"distance": abs})(), "`measured` gives a Own"),
    ],
)
def test_a_shape_is_told_which_distance_is_wrong(hook, answer, text):
    wrong = type("Wrong", (jf.Sphere,), {hook: answer})
    with pytest.raises(jf.SceneError, match=text):
        jf.build(jf.Scene([BALL], contacts=[jf.Contact(BALL, wrong(1.0))]))


def test_a_distance_in_double_precision_is_refused_in_single():
    wrong = type(
        "Wrong", (jf.Sphere,), {"distance": lambda self, point: jf.Sphere.distance(self, point) * np.ones(1)[0]}
    )
    scene = jf.Scene([BALL], contacts=[jf.Contact(BALL, wrong(1.0))])
    jf.build(scene)
    with pytest.raises(jf.SceneError, match=r"`distance` gives .* type float64 .* of the type float32"):
        jf.build(scene, dtype=np.float32)


def test_soft_bodies_look_at_distances_too():
    block = jf.SoftBody(jf.mesh.box((1, 1, 1), 1), young=1e5, poisson=0.3, density=1e3, name="block")
    wrong = type("Wrong", (jf.Box,), {"distance": lambda self, point: 1})
    with pytest.raises(jf.SceneError, match="contact 0 touches a Wrong: `distance` gives 1"):
        jf.build(jf.Scene([block], contacts=[jf.Contact(block, wrong((1.0, 1.0, 1.0)), faces=True)]))


@pytest.mark.parametrize(
    "answer",
    [
        None,
        (1.0, np.zeros(3)),
        (np.ones(1), np.zeros(3), np.eye(3)),
        (1.0, np.zeros(2), np.eye(3)),
        (1.0, np.zeros(3), "round"),
        (None, np.zeros(3), np.eye(3)),
    ],
)
def test_a_solid_is_told_which_mass_properties_are_wrong(answer):
    wrong = type("Wrong", (jf.Sphere,), {"mass_properties": lambda self: answer})
    text = "Wrong: `mass_properties` gives .*; it must give three values, a volume .m.3., a centre"
    with pytest.raises(jf.SceneError, match=f'the shape of "mine", {text}'):
        jf.build(jf.Scene([jf.RigidBody(wrong(1.0), density=1.0, name="mine")]))
    jf.Contact(BALL, wrong(1.0))  # of the ground no mass is asked: a surface may be open


@pytest.mark.parametrize("inertia", ["round", [[1.0, 2.0], [3.0]], np.ones(3)])
def test_an_inertia_that_is_no_matrix(inertia):
    with pytest.raises(jf.SceneError, match='inertia of "sphere" must be a symmetric positive definite'):
        jf.RigidBody(jf.Sphere(1.0), mass=1.0, inertia=inertia)


@pytest.mark.parametrize(
    ("hook", "answer", "text"),
    [
        ("edges", lambda self: "sharp", "`edges` gives 'sharp'; it must give three halves"),
        ("edges", lambda self: np.ones(2), r"`edges` gives an array of shape \(2,\)"),
        ("extent", lambda self: None, r"`extent` gives None; it must give points \(k, 3\)"),
        ("thickness", lambda self: None, "`thickness` gives None; it must give one number"),
        ("features", lambda self: np.zeros((1, 3)), "`features` gives .* points .* and the radius"),
        ("features", lambda self: (np.zeros((2, 3)), np.zeros(1)), "`features` gives"),
        ("features", lambda self: (np.zeros(3), np.zeros(1)), r"`features` gives \(an array of shape \(3,\)"),
        ("features", lambda self: (np.zeros((1, 3)), -np.ones(1)), ".* 0 for none"),
        ("segments", lambda self: (np.zeros((1, 3)), np.zeros(1)), "`segments` gives"),
        ("circles", lambda self: np.zeros((1, 3)), "`circles` gives an array"),
    ],
)
def test_a_solid_is_told_which_points_are_wrong(hook, answer, text):
    wrong = type("Wrong", (jf.Sphere,), {hook: answer})
    with pytest.raises(jf.SceneError, match=f'the shape of "mine", Wrong: {text}'):
        jf.RigidBody(wrong(1.0), mass=1.0, name="mine")
