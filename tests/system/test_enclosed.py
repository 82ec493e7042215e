"""Bodies inside a soft one, or in one place with it, of which no point that touches tells: `build` says so."""

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.building.bodies import BodyIndex
from jaxfem.building.enclosed import enclosed_depth

HALF = np.sqrt(0.5)
TURNED = (HALF, 0.0, HALF, 0.0)


def cube(name, side=0.2, at=(0, 0, 0)):
    low = np.asarray(at) - side / 2
    return jf.SoftBody(jf.mesh.box((side,) * 3, 2, origin=tuple(low)), 1e5, 0.3, 1e3, name=name)


def depth(a, b):
    """Of a contact of two bodies, on the host alone."""
    soft = [each for each in (a, b) if isinstance(each, jf.SoftBody)]
    rigid = [each for each in (a, b) if isinstance(each, jf.RigidBody)]
    return enclosed_depth(jf.Contact(a, b), BodyIndex(soft, [x.name for x in soft], rigid, [x.name for x in rigid]))


@pytest.mark.parametrize(
    "shape",
    [jf.Sphere(0.03), jf.Box((0.04,) * 3), jf.Cylinder(0.02, 0.05), jf.Capsule(0.02, 0.02)],
    ids=lambda shape: type(shape).__name__,
)
def test_a_small_body_between_the_nodes_of_a_soft_one_is_found(shape):
    inside = jf.RigidBody(shape, mass=0.1, position=(0.05, 0, 0.02), orientation=TURNED, name="pea")
    assert 0.04 < depth(cube("cube"), inside) < 0.1  # from its middle to the nearest face there are 5 cm
    beside = jf.RigidBody(shape, mass=0.1, position=(0.15, 0, 0.02), name="pea")
    assert depth(cube("cube"), beside) == 0


def test_a_soft_body_in_a_rigid_one_and_in_a_soft_one_are_found():
    block = jf.RigidBody(jf.Box((0.2, 0.2, 0.6)), mass=1.0, position=(0.2, 0, 0), orientation=TURNED, name="block")
    assert 0.04 < depth(cube("cube", 0.1), block) < 0.1
    assert depth(cube("one"), cube("same")) > 0.04
    assert depth(cube("one"), cube("small", 0.05)) > 0.04
    assert depth(cube("one"), cube("beside", 0.1, at=(0.15, 0, 0))) == 0


def test_two_bodies_in_one_place_are_named():
    """All gaps are 0 there."""
    one, other = cube("one"), cube("other")
    with pytest.warns(jf.OverlapWarning, match='contact 0: "one" and "other" start inside each other'):
        jf.build(jf.Scene([one, other], contacts=[jf.Contact(one, other)]))
