"""Derivatives across impacts of what joints hold: those of central differences, to 1e-6."""

import derivatives
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

DOWN = (0, 1, 0)
LYING = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)


@pytest.mark.slow
def test_derivatives_across_limits_ropes_and_bounces_of_what_is_held_are_those_of_differences():
    """A rod that strikes its hinge's limit, a ball that its rope stops, a rod that bounces off the ground.

    Each is struck while it turns, so that the time of impact hangs on the force that holds it, which is known from the
    impulses of the step before.
    """
    rod = jf.RigidBody(jf.Box((1.0, 0.02, 0.02)), mass=1.0, position=(0.5, 0, 0), name="rod")
    roped = jf.RigidBody(jf.Sphere(0.05), mass=1.0, position=(0.5, 5, 0), name="roped")
    arm = jf.RigidBody(jf.Capsule(0.02, 1.0), mass=1.0, position=(0.5, 9, 0), orientation=LYING, name="arm")
    joints = [
        jf.HingeJoint(None, rod, (0, 0, 0), DOWN, low=-0.4, high=3.0),
        jf.BallJoint(None, arm, (0, 9, 0)),
        jf.DistanceJoint(None, roped, (0, 5, 0), (0.5, 5, 0), length=0.6, rope=True),
    ]
    ground = jf.Contact(arm, jf.Plane(point=(0, 0, -0.3)), restitution=0.5, friction=0.1)
    model, params, state = jf.build(
        jf.Scene([rod, roped, arm], joints=joints, contacts=[ground]), tolerance=1e-13, solver="direct"
    )
    speeds = jnp.array([[0.0, 0, 2.5], [1.0, 0, 1.0], [0.0, 0, -0.5]])
    spins = jnp.array([[0.0, -5.0, 0], [0.0, 0, 0], [0.0, 1.0, 0]])
    weights = jnp.asarray(np.random.default_rng(5).standard_normal((3, 3)))

    def end(*rates):
        rates = jnp.stack(rates)[:, None]
        rigid = state.rigid.replace(velocities=rates * speeds, angular_velocities=rates * spins)
        states, _ = jf.rollout(model, params, state.replace(rigid=rigid), 1 / 60, 24)
        return jnp.sum(states.rigid.positions[-1] * weights)

    derivatives.check(end, (1.0, 1.0, 1.0), forwards=False)
