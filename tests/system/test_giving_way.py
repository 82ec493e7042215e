"""Mass ratios at which the trace of compliance gives: right below them, named by a status above."""

import jax.numpy as jnp
import numpy as np
import pytest
import scenes

import jaxfem as jf
from jaxfem.solvers import Status, describe

DT = 1 / 60


def pendulum(mass, **build):
    """A link of 1 g on the world, a ball of `mass` [kg] at its end, hanging."""
    link = jf.RigidBody(jf.Box((0.02, 0.02, 0.5)), mass=1e-3, position=(0, 0, -0.25), name="link")
    ball = jf.RigidBody(jf.Sphere(0.05), mass=mass, position=(0, 0, -0.55), name="ball")
    joints = [jf.BallJoint(None, link, (0, 0, 0), name="nail"), jf.BallJoint(link, ball, (0, 0, -0.5), name="hook")]
    return jf.build(jf.Scene([link, ball], joints=joints), **build)


def opened(states):
    """How far the upper joint is open at the end [m]."""
    return float(np.abs(states.rigid.positions[-1, 0, 2] + 0.25))


@pytest.mark.parametrize(
    ("dtype", "solver", "light", "heavy"),
    [
        (jnp.float64, "direct", 1e5, 1e6),
        (jnp.float32, "mprgp", 1e2, 1e3),
        (jnp.float32, "direct", 1e2, 1e3),
    ],
)
def test_a_load_that_opens_a_joint_is_named(dtype, solver, light, heavy):
    model, params, state = pendulum(1.0, dtype=dtype, solver=solver)
    masses = params.rigid.mass
    for mass, holds in ((light, True), (heavy, False)):
        own = params.replace(rigid=params.rigid.replace(mass=masses.at[1].set(mass)))
        states, infos = scenes.rolled(model, own, state, DT, 20)
        said = describe(infos.status[-1])
        if holds:
            assert not infos.status.any() and opened(states) < 3e-4, said
        else:
            assert opened(states) > 2e-3
            assert Status(int(infos.status[-1])) is Status.GAVE_WAY, said
            assert '"nail"' in said or '"hook"' in said


def test_a_load_that_sinks_a_contact_is_named():
    light = jf.RigidBody(jf.Box((0.2, 0.2, 0.2)), mass=1.0, position=(0, 0, 0.1), name="light")
    heavy = jf.RigidBody(jf.Box((0.2, 0.2, 0.2)), mass=1.0, position=(0, 0, 0.3), name="heavy")
    contacts = [jf.Contact(light, jf.Plane(), name="floor"), jf.Contact(heavy, light, name="top")]
    model, params, state = jf.build(jf.Scene([light, heavy], contacts=contacts))
    for mass, holds in ((1e5, True), (1e9, False)):
        own = params.replace(rigid=params.rigid.replace(mass=jnp.array([1.0, mass])))
        states, infos = scenes.rolled(model, own, state, DT, 20)
        sunk = 0.3 - float(states.rigid.positions[-1, 1, 2])
        said = describe(infos.status[-1])
        if holds:
            assert not infos.status.any() and abs(sunk) < 1e-4, said
        else:
            assert sunk > 4e-4
            assert Status(int(infos.status[-1])) is Status.GAVE_WAY and 'contact "' in said, said
