"""Standard scenes, each with the methods that solve it: the same programs serve their answers and golden values."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scenes

import jaxfem as jf

SOFT = {"poisson": 0.3, "density": 1000.0, "damping": 2e-3}


def soft_beam(strain):
    """A clamped beam of six or twelve elements that starts to sag."""
    body = jf.SoftBody(
        jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1)),
        young=2.6e5,
        fixed="x-",
        strain=strain,
        **{**SOFT, "poisson": 0.4, "density": 1070.0},
    )
    return jf.Scene([body])


def block_on_plane():
    """A soft block that lands on rough ground and slides."""
    mesh = jf.mesh.box((0.2, 0.2, 0.1), (2, 2, 1), origin=(0, 0, 0.01))
    body = jf.SoftBody(mesh, young=2e4, velocity=(0.6, 0.2, -1.0), **SOFT)
    return jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=0.5)])


def ball_on_block():
    """A rigid ball that falls on a soft block, nearly incompressible and smoothed."""
    mesh = jf.mesh.box((0.2, 0.2, 0.1), (2, 2, 1), origin=(-0.1, -0.1, 0))
    body = jf.SoftBody(mesh, young=5e4, fixed="z-", strain="smoothed", **{**SOFT, "poisson": 0.49})
    ball = jf.RigidBody(jf.Sphere(0.05), mass=2.0, position=(0.02, 0.01, 0.17), velocity=(0.3, 0, -1))
    # It lands beside a node, which carries it: without the faces, the rows are those of contact at nodes alone.
    return jf.Scene([body, ball], contacts=[jf.Contact(body, ball, friction=0.4, faces=False)])


def arm_with_tool():
    """A soft arm, a rigid tool welded to it, and on a hinge with limits and a weak motor a second one."""
    mesh = jf.mesh.box((0.2, 0.05, 0.05), (3, 1, 1))
    body = jf.SoftBody(mesh, young=1e5, fixed="x-", **SOFT)
    tool = jf.RigidBody(jf.Box((0.1, 0.05, 0.05)), mass=0.1, position=(0.25, 0.025, 0.025))
    tip = jf.RigidBody(jf.Box((0.1, 0.02, 0.02)), mass=0.05, position=(0.35, 0.025, 0.025))
    hinge = jf.HingeJoint(tool, tip, (0.3, 0.025, 0.025), (0, 1, 0), low=-0.1, high=0.2, motor=jf.Motor(2.0, 0.004))
    return jf.Scene([body, tool, tip], joints=[jf.WeldJoint(body, tool, nodes="x+", compliance=1e-6), hinge])


def doll():
    """A branching doll that folds up on its limits: five links, a motor, a rope, a ball that lands on the ground."""
    trunk = jf.RigidBody(jf.Box((0.1, 0.1, 0.4)), mass=3.0, position=(0, 0, 1.0), angular_velocity=(0, 3.0, 0))
    arms = [jf.RigidBody(jf.Box((0.4, 0.1, 0.1)), mass=1.0, position=(0.3 * s, 0, 1.2)) for s in (-1, 1)]
    hands = [jf.RigidBody(jf.Box((0.2, 0.1, 0.1)), mass=0.2, position=(0.6 * s, 0, 1.2)) for s in (-1, 1)]
    ball = jf.RigidBody(jf.Sphere(0.1), mass=0.5, position=(0, 0, 0.11), velocity=(0.5, 0, -0.5))
    joints = [
        *[
            jf.HingeJoint(trunk, arm, (0.1 * s, 0, 1.2), (0, 1, 0), low=-0.1, high=0.1)
            for arm, s in zip(arms, (-1, 1), strict=True)
        ],
        jf.HingeJoint(arms[0], hands[0], (-0.5, 0, 1.2), (0, 1, 0), motor=jf.Motor(3.0, 0.05)),
        jf.BallJoint(arms[1], hands[1], (0.5, 0, 1.2)),
        jf.DistanceJoint(trunk, ball, (0, 0, 0.8), (0, 0, 0.21), length=0.6, rope=True),
        jf.BallJoint(None, trunk, (0, 0, 1.2)),
    ]
    bodies = [trunk, *arms, *hands, ball]
    return jf.Scene(bodies, joints=joints, contacts=[jf.Contact(ball, jf.Plane((0, 0, 0), (0, 0, 1)), friction=0.0)])


def chain():
    """Four links that hang from the world and swing, ten times their mass on the last."""
    links = [jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0.5 + i, 0, 0)) for i in range(3)]
    bodies = [None, *links, jf.RigidBody(jf.Sphere(0.2), mass=10.0, position=(3.5, 0, 0))]
    joints = [jf.BallJoint(bodies[i], bodies[i + 1], (i, 0, 0)) for i in range(4)]
    return jf.Scene(bodies[1:], joints=joints)


def sliding_box(velocity=(1.2, 0.9, 0.0), friction=0.5):
    """A rigid box that slides on a plane."""
    body = jf.RigidBody(jf.Box((0.4, 0.4, 0.1)), mass=2.0, position=(0, 0, 0.05), velocity=velocity)
    return jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=friction)])


class Standard(NamedTuple):
    """A scene by its maker and the maker's arguments, what solves it, and how far it is run, in steps of 10 ms."""

    make: Any
    arguments: tuple
    methods: tuple[str, ...]
    steps: int
    tolerance: float

    def run(self, method, dtype=jnp.float64, tolerance=None):
        """(model, states, infos) as NumPy arrays; every solve has converged."""
        built = jf.build(self.make(*self.arguments), solver=method, tolerance=tolerance or self.tolerance, dtype=dtype)
        states, infos = jax.tree.map(np.asarray, jf.rollout(*built, 1e-2, self.steps))
        assert not infos.status.any()
        return built[0], states, infos


STANDARD = {
    "beam of elements": Standard(soft_beam, ("element",), ("condensed", "mprgp"), scenes.CHUNK, 1e-9),
    "beam by nodal volume": Standard(soft_beam, ("nodal_volume",), ("condensed", "mprgp"), scenes.CHUNK, 1e-9),
    "beam smoothed": Standard(soft_beam, ("smoothed",), ("condensed", "mprgp"), scenes.CHUNK, 1e-9),
    "block on plane": Standard(block_on_plane, (), ("condensed", "mprgp"), 12, 1e-9),
    "ball on block": Standard(ball_on_block, (), ("condensed", "mprgp"), 12, 1e-9),
    "arm with tool": Standard(arm_with_tool, (), ("condensed", "mprgp"), 12, 1e-9),
    "doll": Standard(doll, (), ("direct", "mprgp", "pgs"), 40, 1e-11),
    "chain": Standard(chain, (), ("direct", "mprgp"), scenes.CHUNK, 1e-9),
    # At 1e-9 the direct search's rounds of friction bounds circle in some steps, and it says so.
    "sliding box": Standard(sliding_box, (), ("direct", "mprgp"), scenes.CHUNK, 3e-11),
}
