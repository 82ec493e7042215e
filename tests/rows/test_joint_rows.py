"""Joint and contact rows: rates are derivatives of what they measure; geometric stiffness bounds the exact one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxfem.rigid.dynamics import turned
from jaxfem.rigid.shapes import Box, Sphere
from jaxfem.rotation import quaternion_to_matrix
from jaxfem.rows.attachments import Configuration, RigidFrame, RigidPoint, SoftPoint, WorldPoint
from jaxfem.rows.contact import ShapeContacts, tangents
from jaxfem.rows.coordinates import Angle, Separation, Travel
from jaxfem.rows.locks import FrameLock, LineLock, PointLock, Softness, tension_stiffness
from jaxfem.schemes import Stage

RNG = np.random.default_rng(5)
NODES, BODIES = 4, 3
STAGE = Stage(None, None, None, None, 1.0, 1.0, 1.0)  # the end of a step of 1 s
RIGID = Softness(jnp.zeros(2), jnp.zeros(2))


def bodies(*numbers):
    return jnp.asarray(numbers, jnp.int32)


def vectors(*shape):
    return jnp.asarray(RNG.normal(size=shape))


START = vectors(NODES, 3), vectors(BODIES, 3), vectors(BODIES, 4)
POINT, OTHER = RigidPoint(bodies(0, 1), vectors(2, 3)), RigidPoint(bodies(1, 2), vectors(2, 3))
SOFT = SoftPoint(jnp.asarray([[0, 1, 2, 3], [1, 1, 2, 0]], jnp.int32), jnp.asarray([[0.1, 0.2, 0.3, 0.4]] * 2))
FRAME = RigidFrame(bodies(0, 1), jnp.tile(jnp.eye(3), (2, 1, 1)))


def configuration(velocities, time):
    """START moved along (n + 2 b, 3) for a time: nodes and centres straight, bodies by the exponential."""
    x, c, q = START
    v, linear, angular = jnp.split(velocities, [NODES, NODES + BODIES])
    turns = quaternion_to_matrix(turned(q / jnp.linalg.norm(q, axis=1, keepdims=True), time * angular))
    return Configuration(x + time * v, c + time * linear, turns)


MEASURES = {
    "point": lambda at: PointLock(POINT, OTHER).rows(at, RIGID, STAGE),
    "soft point": lambda at: PointLock(SOFT, OTHER).rows(at, RIGID, STAGE),
    "world point": lambda at: PointLock(WorldPoint(jnp.ones((2, 3))), POINT).rows(at, RIGID, STAGE),
    "line": lambda at: LineLock(POINT, OTHER, FRAME).rows(at, RIGID, STAGE),
    "angle": lambda at: Angle(FRAME, frame_along(at)).measured(at),
    "travel": lambda at: Travel(POINT, SOFT, FRAME).measured(at),
    "separation": lambda at: Separation(POINT, SOFT).measured(at),
    "box contact": lambda at: ShapeContacts(
        SOFT, jnp.zeros(2), Box(jnp.ones((2, 3))), bodies(0, 1), jnp.ones(2), False, False
    ).pairs(at),
    "ball contact": lambda at: ShapeContacts(
        POINT, jnp.full(2, 0.1), Sphere(jnp.ones(2)), bodies(2, 0), jnp.ones(2), False, False
    ).pairs(at),
}


def frame_along(_):
    """Frames of other bodies whose third axes agree with FRAME's at the start, turned about them."""
    at = configuration(jnp.zeros((NODES + 2 * BODIES, 3)), 0.0)
    spin = jnp.asarray([[[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1.0]]] * 2)
    axes = jnp.einsum("mij,mjk->mik", FRAME.axes(at), spin)
    return RigidFrame(bodies(1, 2), jnp.einsum("mji,mjk->mik", at.rotations[1:], axes))


def value_and_rate(measured, velocities):
    """What is measured, flat, and the rate its rows give."""
    if hasattr(measured, "bias"):
        return -measured.bias.ravel(), measured.apply(velocities).ravel()
    if hasattr(measured, "gap"):
        rows = jnp.einsum("mi,mik->mk", measured.normal, measured.relative.jacobian)
        gathered = velocities[measured.relative.triples].reshape(rows.shape)
        return measured.gap, jnp.sum(rows * gathered, 1)
    gathered = velocities[measured.triples].reshape(measured.jacobian.shape[0], -1)
    return measured.value, jnp.sum(measured.jacobian[:, 0] * gathered, 1)


@pytest.mark.parametrize("name", MEASURES)
def test_rates_are_derivatives(name):
    velocities = vectors(NODES + 2 * BODIES, 3)

    @jax.jit
    def both(time):
        return value_and_rate(MEASURES[name](configuration(velocities, time)), velocities)

    np.testing.assert_allclose(jax.jacfwd(both)(0.0)[0], both(0.0)[1], atol=1e-10)


@pytest.mark.parametrize("held", [3, 2])
def test_locks_of_frames_hold_what_is_aligned(held):
    """At aligned frames the gap is zero and its rate the relative spin along a's axes."""
    velocities = vectors(NODES + 2 * BODIES, 3)
    at = configuration(velocities, 0.0)
    other = RigidFrame(bodies(1, 2), jnp.einsum("mji,mjk->mik", at.rotations[1:], FRAME.axes(at)))

    @jax.jit
    def both(time):
        rows = FrameLock(FRAME, other, held).rows(configuration(velocities, time), RIGID, STAGE)
        return -rows.bias, rows.apply(velocities)

    gap, rate = both(0.0)
    np.testing.assert_allclose(gap, 0, atol=1e-14)
    np.testing.assert_allclose(jax.jacfwd(both)(0.0)[0], rate, atol=1e-10)


def test_geometric_stiffness_bounds_the_exact_one_and_meets_it_where_the_pull_is_along_the_arm():
    at = configuration(jnp.zeros((NODES + 2 * BODIES, 3)), 0.0)
    lock = PointLock(WorldPoint(jnp.zeros((1, 3))), RigidPoint(bodies(0), vectors(1, 3)))
    arm = np.asarray(lock.b.arm(at)[0])
    for force in (*np.asarray(vectors(20, 3)), 3 * arm):
        found = np.asarray(tension_stiffness(lock, jnp.asarray(force)[None], at))[0]
        exact = force @ arm * np.eye(3) - 0.5 * (np.outer(arm, force) + np.outer(force, arm))
        assert np.linalg.eigvalsh(found - exact).min() > -1e-12 and np.linalg.eigvalsh(found).min() > -1e-12
    np.testing.assert_allclose(found, exact, atol=1e-12)
    nothing = tension_stiffness(lock, jnp.zeros((1, 3)), at)
    np.testing.assert_allclose(nothing, 0)
    slope = jax.jacfwd(lambda f: tension_stiffness(lock, f, at))(jnp.zeros((1, 3)))
    assert np.isfinite(slope).all()


def test_tangents_are_orthonormal():
    normal = vectors(50, 3)
    normal /= jnp.linalg.norm(normal, axis=1, keepdims=True)
    frame = np.concatenate([np.asarray(tangents(normal)), np.asarray(normal)[:, None]], 1)
    np.testing.assert_allclose(np.einsum("mij,mkj->mik", frame, frame), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)


@pytest.mark.parametrize("held", [3, 2])
def test_frames_are_apart_by_the_angle_between_them_up_to_half_a_turn(held):
    """It was the sine: a soft weld bent further than a quarter turn gave way, and turned over it was closed."""
    axes = np.array([[1.0, 0, 0], [0.6, 0.8, 0]]) if held == 2 else np.array([[2.0, -1, 2], [0, 0, 3]]) / 3
    lock = FrameLock(FRAME, RigidFrame(bodies(1, 2), jnp.tile(jnp.eye(3), (2, 1, 1))), held)

    @jax.jit
    def gap(angle):
        half = angle / 2
        turn = jnp.concatenate([jnp.full((1, 1), jnp.cos(half)), jnp.sin(half) * axes[:1]], 1)
        back = jnp.concatenate([jnp.full((1, 1), jnp.cos(half)), jnp.sin(half) * axes[1:]], 1)
        start = jnp.asarray([[1.0, 0, 0, 0]])
        q = jnp.concatenate([start, turn, product(turn[0], back[0])[None]])
        at = Configuration(jnp.zeros((0, 3)), jnp.zeros((3, 3)), quaternion_to_matrix(q))
        return -lock.rows(at, RIGID, STAGE).bias

    for angle in (0.0, 1e-9, 0.00999, 0.0101, 1.0, np.pi / 2, 2.5, 3.14, np.pi):
        found = np.asarray(gap(angle))
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), angle, atol=2e-7, rtol=1e-12)
        if angle < 3.14:  # along the turn, in a's own axes
            np.testing.assert_allclose(found, angle * axes[:, :held], atol=2e-7)
    slope = np.asarray(jax.jit(jax.jacrev(gap))(0.0))
    np.testing.assert_allclose(slope, axes[:, :held], atol=1e-12)


def product(p, q):
    """Of two quaternions."""
    vector = p[0] * q[1:] + q[0] * p[1:] + jnp.cross(p[1:], q[1:])
    return jnp.concatenate([p[:1] * q[:1] - jnp.dot(p[1:], q[1:]), vector])
