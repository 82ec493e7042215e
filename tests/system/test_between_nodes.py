"""Soft bodies none of whose nodes is over the other: points of their edges keep them apart."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

SIDE = 0.1


def cube(name, degrees, height, **more):
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    mesh = jf.mesh.box((SIDE,) * 3, 1, origin=(-SIDE / 2, -SIDE / 2, height)).rotated(turn)
    values = {"young": 1e6, "poisson": 0.3, "density": 1000.0, "damping": 0.02, **more}
    return jf.SoftBody(mesh, **values, name=name)


def two(degrees, **contact):
    """A cube of five elements on another one, turned about the vertical; the lower one is held."""
    lower = cube("lower", 0, 0.0)
    held = jf.SoftBody(lower.mesh, 1e6, 0.3, 1000.0, fixed="z-", damping=0.02, name="lower")
    upper = cube("upper", degrees, SIDE + 1e-3)
    return jf.build(jf.Scene([held, upper], contacts=[jf.Contact(upper, held, **contact)]))


@pytest.mark.parametrize("degrees", [45, 0])
def test_a_coarse_cube_stands_on_another_however_it_is_turned(degrees):
    """At 45 degrees all corners hang outside of the other's face; at 0 nodes say all."""
    model, params, state = two(degrees, faces=True)
    states, info = jf.rollout(model, params, state, 1 / 60, 20)
    assert not info.status.any() and info.iterations.max() < 2000
    upper = np.asarray(states.positions[-1])[np.asarray(model.node_body) == 1]
    assert upper[:, 2].min() > SIDE - 1e-3
    assert float(jnp.abs(states.velocities[-1]).max()) < 0.02


def test_points_between_nodes_are_there_where_they_are_asked_for():
    def groups(model):
        return {name for name in model.contacts if "edges" in name}

    assert groups(two(0, faces=True)[0]) and not groups(two(0, faces=False)[0])
    with pytest.warns(jf.AccuracyWarning, match="0.141 m apart and the other is 0.1 m thin, so edges may pass"):
        assert not groups(two(0)[0])
    fine = [
        jf.SoftBody(jf.mesh.box((SIDE,) * 3, 2, origin=(0, 0, k * SIDE)), 1e6, 0.3, 1e3, name=f"cube {k}")
        for k in range(2)
    ]
    for asked, there in ((None, False), (True, True)):
        model, *_ = jf.build(jf.Scene(fine, contacts=[jf.Contact(*fine, faces=asked)]))
        assert bool(groups(model)) == there
