"""What is declared and changes nothing: `build` says so by name, and inside jit a status does."""

import warnings

import jax
import jax.numpy as jnp
import pytest

import jaxfem as jf
from jaxfem.solvers import Status, describe
from jaxfem.stepping.values import value_status


def told(scene):
    """What `build` returns, and the sentences on what changes nothing."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        built = jf.build(scene)
    return built, [str(each.message) for each in caught if each.category is jf.UnusedWarning]


def scene(used):
    """Soft and rigid bodies, joints and a contact, each with a number that is of use or not."""
    moving = 0.0 if used else 1.0
    bar = jf.SoftBody(
        jf.mesh.box((0.2, 0.1, 0.1), 1),
        young=1e5,
        poisson=0.3,
        density=1e3,
        fixed="x-",
        loads=[jf.NodalForce("x+" if used else "x-", (0, 0, -1.0))],
        name="bar",
    )
    held = jf.SoftBody(
        jf.mesh.box((0.1,) * 3, 1, origin=(0, 1, 0)),
        young=1e5,
        poisson=0.3,
        density=1e3,
        fixed="all",
        velocity=(moving, 0, 0),
        name="held",
    )
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(1, 0, 0.1), velocity=(1, 0, 0), name="ball")
    post = jf.RigidBody(
        jf.Box((0.1,) * 3), mass=1.0, position=(2, 0, 0.05), velocity=(0, moving, 0), fixed=True, name="post"
    )
    crank = jf.RigidBody(
        jf.Sphere(0.1),
        mass=1.0,
        position=(3, 0, 1),
        velocity=(0.5, moving, 0),
        motion=jf.Motion((0.5, 0, 0)),
        name="crank",
    )
    softness = 1e-3 if used else 0.0
    joints = [
        jf.BallJoint(ball, None, (1, 0, 0.1), compliance=softness, damping=2.0, name="tie"),
        jf.HingeJoint(
            None, ball, (1, 0, 0.1), (0, 0, 1), motor=jf.Motor(1.0, 0.1, damping=0.0 if used else 0.5), name="axle"
        ),
        jf.WeldJoint(bar, ball, nodes="x+", anchor=(0.0, 0.0, 0.0 if used else 1.0), name="glue"),
        jf.BallJoint(crank, ball if used else post, (3, 0, 1), name="arm"),
    ]
    contacts = [
        jf.Contact(
            ball, jf.Plane(), friction=0.5 if used else 0.0, cone=True, per_node=2 if used else 3, name="ground"
        ),
        jf.Contact(ball if used else post, jf.Plane(), name="foot"),
    ]
    return jf.Scene([bar, held, ball, post, crank], joints=joints, contacts=contacts)


SAID = [
    'a NodalForce on "bar", on nodes that are all fixed or driven',
    'velocity of "held", whose nodes are all fixed or driven',
    'velocity of "post", which is fixed',
    'velocity of "crank", which follows its motion',
    'damping of joint "tie" (rows "point rigid-world"), whose compliance is 0',
    'damping of joint "axle" (rows "angle motor world-rigid"), whose motor drives a rate',
    '"glue" has an anchor beside nodes',
    '"arm", whose ends are all fixed or follow a motion',
    '"ground" has a cone and no friction',
    '"ground" has per_node and no surface',
    '"foot", whose ends are all fixed or follow a motion',
]


def test_each_number_that_changes_nothing_is_named():
    _, sentences = told(scene(used=False))
    for words in SAID:
        assert any(words in each and each.endswith("that changes nothing") for each in sentences), words
    assert len(sentences) == len(SAID)


def test_nothing_is_said_of_what_is_used_and_a_damping_that_is_not_has_a_status_inside_jit():
    (model, params, state), sentences = told(scene(used=True))
    assert sentences == []
    label = next(name for name in params.joints if "motor" in name)
    look = jax.jit(lambda joints: value_status(model, params.replace(joints=joints), state, 1e-2))
    assert int(look(params.joints)) == 0
    damped = params.joints[label].replace(damping=jnp.full(1, 0.3))
    status = look({**params.joints, label: damped})
    assert Status(int(status)) is Status.INVALID_VALUE
    assert f'joints["{label}"].damping must be 0: these motors drive a rate' in describe(status)


@pytest.mark.parametrize("what", ["point", "normal"])
def test_ground_that_is_nowhere_does_not_let_through_in_silence(what):
    ball = jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0, 0, 0.1), name="ball")
    model, params, state = jf.build(jf.Scene([ball], contacts=[jf.Contact(ball, jf.Plane())]))
    (label,) = model.contacts
    group = model.contacts[label]
    shape = group.shape.replace(**{what: getattr(group.shape, what) * jnp.nan})
    lost = model.replace(contacts={label: group.replace(shape=shape)})
    assert Status(int(jf.step(lost, params, state, 1e-2)[1].status)) is Status.NOT_FINITE
