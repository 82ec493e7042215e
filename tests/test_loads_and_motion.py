"""Declared loads and prescribed motion: resultants, work, and what nodes do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from derivatives import Parted

import jaxfem as jf
from jaxfem.loads import load_force

SIZE = (0.2, 0.1, 0.05)


def built(loads=(), **kwargs):
    body = jf.SoftBody(
        jf.mesh.box(SIZE, (2, 2, 1), name="slab"), young=1e5, poisson=0.3, density=1000.0, loads=loads, **kwargs
    )
    return jf.build(jf.Scene([body], gravity=(0, 0, 0)))


def total(loads, positions=None):
    model, params, state = built(loads)
    return model, load_force(model.loads, params.loads, state.positions if positions is None else positions)


def test_nodal_force_acts_on_each_named_node():
    model, f = total([jf.NodalForce("x+", (1.0, 2.0, 3.0))])
    on = np.asarray(model.rest)[:, 0] > SIZE[0] - 1e-9
    np.testing.assert_allclose(f[on], np.tile([1.0, 2.0, 3.0], (on.sum(), 1)))
    assert (np.asarray(f)[~on] == 0).all()


def test_traction_sums_to_stress_times_area():
    _, f = total([jf.Traction("x+", (0.0, 0.0, -200.0))])
    np.testing.assert_allclose(f.sum(0), [0, 0, -200.0 * SIZE[1] * SIZE[2]], atol=1e-15)


def test_pressure_pushes_inward_and_turns_with_the_body():
    _, f = total([jf.Pressure("x+", 300.0)])
    expected = np.array([-300.0 * SIZE[1] * SIZE[2], 0, 0])
    np.testing.assert_allclose(f.sum(0), expected, atol=1e-15)
    turn = scenes.random_rotation(2)
    model, params, state = built([jf.Pressure("x+", 300.0)])
    turned = load_force(model.loads, params.loads, state.positions @ turn.T)
    np.testing.assert_allclose(turned.sum(0), turn @ expected, atol=1e-14)


def test_pressure_on_the_whole_surface_has_no_resultant():
    _, f = total([jf.Pressure("surface", 300.0)])
    np.testing.assert_allclose(f.sum(0), 0, atol=1e-14)


def test_point_force_keeps_force_and_moment():
    point, force = np.array([0.13, 0.04, 0.02]), np.array([1.0, -2.0, 0.5])
    model, f = total([jf.PointForce(point, force)])
    np.testing.assert_allclose(f.sum(0), force, atol=1e-14)
    np.testing.assert_allclose(np.cross(model.rest, f).sum(0), np.cross(point, force), atol=1e-14)


@pytest.mark.parametrize(
    ("load", "text"),
    [
        (jf.PointForce((1.0, 0, 0), (0, 0, 1.0)), 'PointForce of "slab" acts at .* outside the body'),
        (jf.NodalForce("x+", (0, 1.0)), r'force of a NodalForce on "slab" is \(0, 1.0\)'),
        (jf.Pressure([[0, 1, 2]], 1.0), 'faces of a load on "slab" must be triangles'),
        (jf.Traction("top", (0, 0, 1.0)), "top"),
        (jf.Pressure("x+", np.nan), "finite"),
    ],
)
def test_impossible_loads_are_refused(load, text):
    with pytest.raises(ValueError, match=text):
        built([load])


def test_driven_nodes_follow_their_motion():
    motion = jf.Motion(velocity=(0.1, 0, 0), amplitude=(0, 0.01, 0), frequency=2.0, angular_velocity=(1.0, 0, 0))
    model, params, state = built(driven=[jf.Driven("x+", motion)], fixed="x-")
    dt, steps = 1e-2, 30
    states, info = jf.rollout(model, params, state, dt, steps)
    assert (info.status == 0).all()
    t = dt * steps
    driven = np.asarray(model.driven[0])
    rest = np.asarray(model.rest)[driven]
    turn = np.asarray(jf.rotation.rotation_vector_to_matrix(jnp.array([t, 0, 0])))
    expected = rest @ turn.T + np.array([0.1 * t, 0.01 * np.sin(2 * np.pi * 2 * t), 0])
    np.testing.assert_allclose(states.positions[-1][driven], expected, atol=1e-12)
    held = np.asarray(model.rest)[:, 0] < 1e-9
    np.testing.assert_allclose(states.positions[-1][held], np.asarray(model.rest)[held], atol=1e-15)


@pytest.mark.slow
def test_derivative_in_a_motion_and_in_a_load():
    motion = jf.Motion(amplitude=(0, 0.01, 0), frequency=2.0)
    body = jf.SoftBody(
        jf.mesh.box(SIZE, (2, 1, 1)),
        young=1e5,
        poisson=0.3,
        density=1000.0,
        driven=[jf.Driven("x-", motion)],
        loads=[jf.Pressure("x+", 100.0)],
    )
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-13)

    @Parted
    def loss(h):
        (old,) = params.motions
        own = params.replace(motions=(old.replace(frequency=old.frequency + h),), loads=(params.loads[0] + 100 * h,))
        return 1e3 * jnp.sum(jf.rollout(model, own, state, 1e-2, 5)[0].positions[-1] ** 2)

    forward, (backward,) = loss.forwards(0.0, direction=(1.0,)), loss.backwards(0.0)
    central = (loss(1e-5) - loss(-1e-5)) / 2e-5
    np.testing.assert_allclose(forward, backward, rtol=1e-10)
    np.testing.assert_allclose(forward, central, rtol=1e-6)


@pytest.mark.slow
def test_float32_driven_nodes_do_not_drift():
    """Two thousand steps of a shake: rounding of increments would add up; places do not."""
    motion = jf.Motion(amplitude=(0, 0.01, 0), frequency=2.0)
    body = jf.SoftBody(
        jf.mesh.box(SIZE, (1, 1, 1)), young=1e5, poisson=0.3, density=1000.0, driven=[jf.Driven("x+", motion)]
    )
    model, params, state = jf.build(jf.Scene([body], gravity=(0, 0, 0)), dtype=jnp.float32)
    states, _ = jf.rollout(model, params, state, 1e-3, 2000, every=2000)
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    driven = np.asarray(model.driven[0])
    expected = np.asarray(model.rest)[driven] + [0, 0.01 * np.sin(2 * np.pi * 2 * float(last.time)), 0]
    np.testing.assert_allclose(last.positions[driven], expected, atol=2e-7)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"driven": jf.Driven("x+", jf.Motion())}, 'driven of "slab" is .* give a list, like driven='),
        ({"driven": [jf.Motion()]}, 'driven of "slab"'),
        ({"driven": [jf.Driven("x+", jf.Motion(velocity=0.1))]}, "velocity of a motion .* give three finite numbers"),
        ({"driven": [jf.Driven("x+", jf.Motion(frequency=np.nan))]}, "frequency of a motion .* one finite number"),
        ({"driven": [jf.Driven("x+", (0, 0, 1))]}, "has a tuple for a motion"),
        ({"loads": [(0, 0, 1)]}, 'loads of "slab" is .* give a list, like loads='),
        ({"fixed": "bottom"}, "bottom"),
        ({"fixed": np.ones(3, bool)}, 'fixed of "slab" is a mask of shape'),
        ({"fixed": [0.5]}, 'fixed of "slab" has dtype float64'),
        ({"fixed": [99]}, 'fixed of "slab" names node 99'),
        ({"velocity": (0, 0)}, 'velocity of "slab" has shape'),
        ({"strain": "quadratic"}, "strain of .* known: element"),
    ],
)
def test_impossible_bodies_are_refused(change, text):
    with pytest.raises(ValueError, match=text):
        built(**change)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda body: jf.build(body), "build takes a Scene, not a SoftBody"),
        (lambda body: jf.Scene(body), "bodies is a single SoftBody"),
        (lambda body: jf.Scene([]), "the scene holds no body"),
        (lambda body: jf.Scene([body], gravity=-9.81), "gravity is -9.81; give three finite numbers"),
        (lambda body: jf.build(jf.Scene([body]), solver="cholesky"), "solver is 'cholesky'; known: auto"),
        (lambda body: jf.build(jf.Scene([body]), tolerance=0.0), "tolerance is 0.0"),
    ],
)
def test_impossible_scenes_are_refused(call, text):
    body = jf.SoftBody(jf.mesh.box(SIZE, (1, 1, 1)), young=1e5, poisson=0.3, density=1000.0)
    with pytest.raises(jf.SceneError, match=text):
        call(body)
