"""Friction in the true cone: the same in all directions, by every method; sticking, sliding, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.rows.bounds import inscribed

MU = 0.5


def pushed(method, cone, angle=0.7, tolerance=1e-10):
    """A box that slides at 1.5 m/s, `angle` from the x axis."""
    velocity = (1.5 * np.cos(angle), 1.5 * np.sin(angle), 0.0)
    body = jf.RigidBody(jf.Box((0.4, 0.4, 0.1)), mass=2.0, position=(0, 0, 0.05), velocity=velocity)
    scene = jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=MU, cone=cone)])
    return jf.build(scene, solver=method, tolerance=tolerance)


@pytest.mark.parametrize("method", ["direct", pytest.param("mprgp", marks=pytest.mark.slow)])
def test_a_box_slows_down_by_mu_g_whichever_way_it_slides(method):
    """And along its way: the pyramid takes more, and turns it."""
    model, params, state = pushed(method, True)
    assert set(model.contacts) == {"cone rigid-ground plane"}
    states, info = jf.rollout(model, params, state, 1e-2, 20)
    assert not info.status.any()
    way = np.array([np.cos(0.7), np.sin(0.7), 0])
    expected = (1.5 - MU * 9.81 * 1e-2 * np.arange(1, 21))[:, None] * way
    np.testing.assert_allclose(states.rigid.velocities[:, 0], expected, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["direct", "mprgp"])
def test_a_box_on_a_slope_slides_beyond_the_angle_of_friction_also_diagonally(method):
    """At 28 degrees, 1.4 beyond it, towards the diagonal of its rows, where the pyramid holds up to 35."""
    a = np.radians(28.0)
    down = np.array([np.sin(a), np.sin(a), 0]) / np.sqrt(2)
    normal = down + np.cos(a) * np.array([0, 0, 1])
    turn = np.array([np.cos(a / 2), *(np.sin(a / 2) * np.array([-1, 1, 0]) / np.sqrt(2))])
    body = jf.RigidBody(jf.Box((0.4, 0.4, 0.1)), mass=2.0, position=0.05 * normal, orientation=turn)
    contact = jf.Contact(body, jf.Plane(normal=normal), friction=MU, cone=True)
    states, info = jf.rollout(*jf.build(jf.Scene([body], contacts=[contact]), solver=method, tolerance=1e-6), 1e-2, 20)
    assert not info.status.any()
    speed = 9.81 * 0.2 * (np.sin(a) - MU * np.cos(a))
    np.testing.assert_allclose(jnp.linalg.norm(states.rigid.velocities[-1, 0]), speed, rtol=1e-4)


def soft_block(method, cone=True, tolerance=1e-9):
    body = jf.SoftBody(
        jf.mesh.box((0.2, 0.2, 0.1), 1, origin=(0, 0, 0.0)), 1e6, 0.3, 1000.0, damping=0.02, velocity=(0.9, 0.7, 0)
    )
    scene = jf.Scene([body], contacts=[jf.Contact(body, jf.Plane(), friction=MU, cone=cone)])
    return jf.build(scene, solver=method, tolerance=tolerance)


@pytest.mark.slow
def test_methods_agree_on_a_soft_block_that_slides():
    ends = {}
    for method in ("condensed", "mprgp", "pgs"):
        states, info = jf.rollout(*soft_block(method), 1e-2, 6)
        assert not info.status.any()
        ends[method] = np.asarray(states.velocities[-1])
        mean = ends[method].mean(0)
        assert mean[1] / mean[0] == pytest.approx(7 / 9, rel=0.02)  # it does not turn aside
    np.testing.assert_allclose(ends["condensed"], ends["pgs"], atol=1e-5)
    np.testing.assert_allclose(ends["mprgp"], ends["pgs"], atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["direct", "condensed"])
def test_derivative_of_a_sliding_distance(method):
    soft = method == "condensed"
    model, params, state = soft_block(method, tolerance=1e-12) if soft else pushed(method, True, tolerance=1e-12)
    (name,) = params.contacts

    def distance(friction, aside):
        contacts = {name: params.contacts[name].replace(friction=friction * params.contacts[name].friction)}
        factor = jnp.array([1.0, 0.0, 1.0]) + aside * jnp.array([0.0, 1.0, 0.0])
        start = state.replace(velocities=state.velocities * factor)
        if not soft:
            start = state.replace(rigid=state.rigid.replace(velocities=state.rigid.velocities * factor))
        states, _ = jf.rollout(model, params.replace(contacts=contacts), start, 1e-2, 4)
        ends = states.positions[-1] if soft else states.rigid.positions[-1]
        return jnp.mean(ends @ jnp.array([1.0, 0.3, 0.0]))

    # A rigid box's corners share by the trace of compliance: forwards and backwards agree to a hundredth of that.
    derivatives.check(distance, (1.0, 1.0), rtol=1e-5, agree=1e-5, forwards=not soft)


def test_rectangles_stand_in_their_discs():
    radius = jnp.array([[1.0], [1.0], [1.0], [2.0], [0.0]])
    wished = jnp.array([[0.1, 0.2], [0.9, 0.1], [3.0, -4.0], [0.0, 5.0], [1.0, 1.0]])
    half = np.asarray(jax.jit(inscribed)(radius, wished))
    np.testing.assert_allclose(half[0], np.sqrt([0.5, 0.5]))
    np.testing.assert_allclose(half[1], (0.9, np.sqrt(1 - 0.81)))
    np.testing.assert_allclose(half[2], (0.6, 0.8))
    np.testing.assert_allclose(half[3:], [(0, 2), (0, 0)], atol=1e-12)
    assert (np.linalg.norm(half, axis=1) <= radius[:, 0] + 1e-12).all()


@pytest.mark.parametrize("scene", [lambda: pushed("direct", False), lambda: soft_block("condensed", cone=False)])
def test_what_a_pyramid_holds_beyond_the_cone_is_counted(scene):
    """And told of, by the contact's name."""
    model, params, state = scene()
    states, info = jf.rollout(model, params, state, 1e-2, 20)
    assert not info.status.any() and info.beyond_cone[0] > 0
    told = str(jf.diagnose(model, params, states, info))
    assert "was more than its coefficient allows, by up to 1.41 times" in told
    assert told.endswith('Contact(cone=True) is the true cone (contact "0")')


@pytest.mark.parametrize(("cone", "angle"), [(True, 0.7), (False, 0.0)])
def test_nothing_is_beyond_a_cone_or_along_an_axis(cone, angle):
    model, params, state = pushed("direct", cone, angle)
    states, info = jf.rollout(model, params, state, 1e-2, 20)
    assert info.beyond_cone is None if cone else not info.beyond_cone.any()
    assert "coefficient" not in str(jf.diagnose(model, params, states, info))


@pytest.mark.slow
def test_a_run_of_the_command_line_says_so_once(tmp_path, capsys):
    body = '[[rigid]]\nname = "crate"\nshape = { box = [0.4, 0.4, 0.1] }\nmass = 2.0\nposition = [0, 0, 0.05]\n'
    scene = (
        body + 'velocity = [1.0, 1.0, 0.0]\n[[contact]]\na = "crate"\nground = { plane = [0, 0, 1] }\nfriction = 0.5\n'
    )
    (tmp_path / "scene.toml").write_text(scene + "[time]\nstep = 0.01\nduration = 0.04\n")
    assert main(["simulate", str(tmp_path / "scene.toml"), "--no-plots", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert said.count("was more than its coefficient allows") == 1 and "(said once)" in said
