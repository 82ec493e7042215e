"""Constants by path: friction, joints, loads, gravity, velocities, moduli; read, put and found from recordings."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import FitError, Recording, Search, Take, attach, fit_takes
from jaxfem.fitting.markers import marker_places, moved_markers
from jaxfem.fitting.paths import group_constants, placed_constants, value_of, with_all
from jaxfem.fitting.spots import Factor, StartTurn, Turn

QUICK = Search(candidates=1, polish=15, tol=1e-6)


def everything(dtype):
    """A scene with one of each: two soft bodies, rigid ones, joints of several rows, contact, loads."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 1))
    up = jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 1))
    loads = [jf.NodalForce("x+", (0.1, 0.0, 0.0)), jf.Pressure("z+", 200.0)]
    soft = jf.SoftBody(mesh, 2e5, 0.3, 1000.0, damping=1e-3, loads=loads, name="beam", velocity=(0.1, 0, 0))
    stiff = jf.SoftBody(up, 4e5, 0.3, 1000.0, damping=2e-3, name="other", fixed="x-")
    box = jf.Box((0.1, 0.1, 0.1))
    door = jf.RigidBody(box, mass=1.0, position=(0, 0, 1.0), name="door")
    ball = jf.RigidBody(jf.Sphere(0.1), mass=2.0, position=(1.0, 0, 1.0), velocity=(0, 1.0, 0), name="ball")
    motor = jf.Motor(0.1, 5.0, position=True, compliance=0.2, damping=0.3)
    hinge = jf.HingeJoint(
        None, door, anchor=(0, 0, 1.2), axis=(0, 1, 0), low=-1.0, high=1.0, motor=motor, compliance=1e-5, name="hinge"
    )
    rope = jf.DistanceJoint(None, ball, anchor=(1, 0, 2), anchor_b=(1, 0, 1.1), rope=True, compliance=1e-4, name="rope")
    floor = jf.Contact(ball, jf.Plane(), friction=0.4, restitution=0.2, name="floor")
    scene = jf.Scene([soft, stiff, door, ball], joints=[hinge, rope], contacts=[floor])
    return jf.build(scene, dtype=dtype)


WANTED = {
    "contact.floor.friction": (0.4, ""),
    "contact.floor.restitution": (0.2, ""),
    "joint.hinge.compliance": (1e-5, "rad/(N m), m/N"),
    "joint.hinge.motor_compliance": (0.2, "rad/(N m)"),
    "joint.hinge.motor_damping": (0.3, "N m s"),
    "joint.hinge.motor_target": (0.1, "rad or rad/s"),
    "joint.hinge.motor_strength": (5.0, "N m"),
    "joint.hinge.low": (-1.0, "rad"),
    "joint.rope.compliance": (1e-4, "m/N"),
    "joint.rope.length": (0.9, "m"),
    "load.0.x": (0.1, "N"),
    "load.0.factor": (1.0, ""),
    "load.1": (200.0, "Pa"),
    "gravity.z": (-9.81, "m/s^2"),
    "gravity.turn.x": (0.0, "rad"),
    "velocity.beam.x": (0.1, "m/s"),
    "velocity.ball.y": (1.0, "m/s"),
    "spin.ball.z": (0.0, "rad/s"),
    "mass.ball": (2.0, "kg"),
    "young.other": (4e5, "Pa"),
    "density.beam": (1000.0, "kg/m^3"),
    "shear_modulus": (3e5 / 2.6, "Pa"),
    "bulk_modulus": (3e5 / 1.2, "Pa"),
}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_every_path_reads_what_the_scene_says_and_takes_another(dtype):
    model, params, state = everything(dtype)
    known = placed_constants(model, params, state)
    for name, (value, unit) in WANTED.items():
        assert known[name].unit == unit, name
        assert value_of(known[name], params, state) == pytest.approx(value, rel=1e-5), name
    shapes = jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), (params, state))
    for name, each in known.items():
        before = value_of(each, params, state)
        new = 1.25 * before if before and np.isfinite(before) else 0.25
        changed = with_all(params, state, {name: jnp.asarray(new, dtype)}, (each,))
        if not isinstance(each.spot, Factor | Turn | StartTurn):
            assert value_of(each, *changed) == pytest.approx(new, rel=1e-5), name
        held = {k: v for k, v in jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), changed)[0].constants.items()}
        assert set(held) == set(shapes[0].constants), name
        assert all(leaf.dtype == dtype for leaf in jax.tree.leaves(changed[0])), name


def test_turns_keep_the_strength_of_gravity_and_moduli_each_other():
    model, params, state = everything("float64")
    known = placed_constants(model, params, state)
    turned, _ = with_all(params, state, {"gravity.turn.x": jnp.asarray(np.pi / 2)}, (known["gravity.turn.x"],))
    assert np.allclose(turned.gravity, (0, 9.81, 0))
    both = known["shear_modulus"], known["bulk_modulus"]
    values = {"shear_modulus": jnp.asarray(1e5), "bulk_modulus": jnp.asarray(1e9)}
    stiff, _ = with_all(params, state, values, both)
    assert np.allclose([value_of(each, stiff, state) for each in both], [1e5, 1e9], rtol=1e-6)
    young, poisson = np.asarray(stiff.young), np.asarray(stiff.poisson)
    assert np.allclose(young[1] / young[0], 2, rtol=1e-3) and np.all(poisson > 0.4998)  # bodies stay in proportion


def test_names_that_are_none_are_told_with_the_nearest():
    model, params, state = everything("float64")
    recording = Recording(0.01 * np.arange(9), np.random.default_rng(0).normal(size=(9, 1, 3)), ("tip",))
    take = Take(model, params, state, recording, {"tip": ("door", (0, 0, 1.0))}, 0.01, release=0.0)
    with pytest.raises(FitError, match=r'did you mean "contact\.floor\.friction"'):
        fit_takes([take], parameters=["contact.flor.friction"], checks="warn")
    for place, message in ((("door", (0, 0)), "three finite"), (("gate", (0, 0, 0)), "no rigid body")):
        with pytest.raises(FitError, match=message):
            attach(model, {"tip": place})
    with pytest.raises(FitError, match="in a scene that"):
        attach(model, {"tip": ("door", (0, 0, 1e3))})


def test_markers_ride_on_rigid_and_soft_bodies_in_the_order_of_their_names():
    model, _, state = everything("float64")
    places = {"a": ("ball", (1.0, 0.1, 1.0)), "b": (0.1, 0.0, 0.0), "c": ("door", (0.05, 0, 1.0)), "d": (0.0, 0.0, 0.0)}
    markers = attach(model, places)
    wanted = np.array([place[1] if isinstance(place[0], str) else place for place in places.values()])
    assert markers.count == 4 and np.allclose(marker_places(markers, state), wanted, atol=1e-12)
    shifts = 1e-3 * np.arange(12.0).reshape(4, 3)
    shifts[[1, 3]] = 0.0, 1e-3, 1e-3
    assert np.allclose(marker_places(moved_markers(markers, model, shifts), state), wanted + shifts, atol=1e-12)
    turn = jnp.array([[1.0, 0, 0, 0], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]])
    moved = state.replace(rigid=state.rigid.replace(orientations=turn))
    assert np.allclose(marker_places(markers, moved)[0], (0.9, 0.0, 1.0), atol=1e-12)
    several = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), (state.positions, state.rigid))
    many = state.replace(positions=several[0], rigid=several[1])
    assert marker_places(markers, many).shape == (2, 4, 3)


def recorded(model, params, state, places, dt, steps, noise, seed=0):
    """A take of what the scene does, with white noise."""
    markers = attach(model, places)
    states, infos = jf.rollout(model, params, state, dt, steps)
    assert not np.asarray(infos.status).any()
    first = np.asarray(marker_places(markers, state))[None]
    clean = np.concatenate([first, np.asarray(marker_places(markers, states))])
    noisy = clean + noise * np.random.default_rng(seed).normal(size=clean.shape)
    return Recording(dt * np.arange(steps + 1), noisy, tuple(places))


def found(scene, places, dt, steps, noise, start, fitted=None, **built):
    """(values found, values of the scene, result) of a scene whose recording is fitted from values that are off."""
    model, params, state = jf.build(scene, **built)
    recording = recorded(model, params, state, places, dt, steps, noise)
    known = {**model.constants, **placed_constants(model, params, state)}
    true = {name: value_of(known[name], params, state) for name in start}
    take = Take(model, params, state, recording, places, dt, compare="position", release=0.0)
    result = fit_takes([take], parameters=list(start), starts=[start], search=QUICK)
    assert all(abs(result.values[n] - true[n]) < 4 * result.standard_errors[n] for n in true), result.summary()
    return result.values, true, result


@pytest.mark.slow
def test_friction_and_speed_of_a_sliding_block_come_back_within_two_percent():
    block = jf.RigidBody(jf.Box((0.1, 0.1, 0.05)), mass=0.5, position=(0, 0, 0.025), velocity=(1.0, 0, 0), name="block")
    floor = jf.Contact(block, jf.Plane(), friction=0.3, name="floor")
    places = {"a": (0.05, 0.05, 0.05), "b": (-0.05, 0.05, 0.05), "c": (0.05, -0.05, 0.05)}
    start = {"contact.floor.friction": 0.6, "velocity.block.x": 0.8}
    values, true, result = found(jf.Scene([block], contacts=[floor]), places, 0.01, 40, 5e-4, start)
    for name, within in (("contact.floor.friction", 0.02), ("velocity.block.x", 0.02)):
        assert values[name] == pytest.approx(true[name], rel=within)
    assert float(result.takes[0].state.rigid.velocities[0, 0]) == pytest.approx(values["velocity.block.x"])


@pytest.mark.slow
def test_constants_of_a_rope_and_a_hinge_come_back_within_five_percent():
    """A ball on an elastic rope, and a bar on a hinge with a torsional spring and damper."""
    ball = jf.RigidBody(jf.Sphere(0.05), mass=0.4, position=(0, 0, -0.5), name="ball")
    bar = jf.RigidBody(jf.Box((0.3, 0.02, 0.02)), mass=0.2, position=(1.15, 0, 0), name="bar")
    rope = jf.DistanceJoint(
        None, ball, anchor=(0, 0, 0), anchor_b=(0, 0, -0.5), rope=True, compliance=0.01, damping=0.5, name="rope"
    )
    spring = jf.Motor(0.0, 1e3, position=True, compliance=1.0, damping=0.02)
    hinge = jf.HingeJoint(None, bar, anchor=(1.0, 0, 0), axis=(0, 1, 0), motor=spring, name="hinge")
    places = {"ball": ("ball", (0, 0, -0.45)), "end": ("bar", (1.3, 0, 0)), "middle": ("bar", (1.15, 0.01, 0.01))}
    start = {
        "joint.rope.compliance": 0.02,
        "joint.rope.damping": 0.2,
        "joint.hinge.motor_compliance": 1.6,
        "joint.hinge.motor_damping": 0.01,
    }
    values, true, _ = found(jf.Scene([ball, bar], joints=[rope, hinge]), places, 0.01, 60, 1e-4, start)
    for name in start:
        assert values[name] == pytest.approx(true[name], rel=0.05), name


@pytest.mark.slow
def test_the_modulus_of_a_bouncing_ball_comes_back_within_five_percent():
    mesh = jf.mesh.ball(0.03, 1)
    ball = jf.SoftBody(
        mesh.translated((0, 0, 0.032)), 5e4, 0.3, 1000.0, damping=1e-3, velocity=(0, 0, -1.0), name="ball"
    )
    floor = jf.Contact(ball, jf.Plane(), friction=0.0, name="floor")
    places = {"top": (0, 0, 0.06), "side": (0.028, 0, 0.032), "back": (0, 0.028, 0.032)}
    start = {"young": 2e5}
    values, true, _ = found(jf.Scene([ball], contacts=[floor]), places, 4e-3, 30, 2e-4, start)
    assert values["young"] == pytest.approx(true["young"], rel=0.05)


@pytest.mark.slow
def test_a_load_the_direction_of_gravity_and_a_speed_come_back_within_their_bars():
    load = jf.NodalForce("x+", (0.0, 0.0, -0.02))
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    body = jf.SoftBody(mesh, 2e5, 0.35, 1070.0, damping=3e-3, fixed="x-", loads=[load], velocity=(0, 0.1, 0), name="b")
    places = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "middle": (0.05, 0.015, 0.03)}
    start = {"load.0.z": -0.01, "gravity.turn.x": 0.2, "velocity.b.y": 0.05}
    values, _, result = found(jf.Scene([body]), places, 1e-2, 30, 2e-5, start, scheme="generalized_alpha")
    assert values["load.0.z"] == pytest.approx(-0.02, rel=0.1) and abs(values["gravity.turn.x"]) < 0.02
    assert "velocity.b.y" in result.summary() and result.status == "converged"


@pytest.mark.slow
def test_near_incompressibility_the_bulk_modulus_has_a_lower_limit_alone():
    """Markers of a body that hardly changes its volume tell that it does not, and how it shears."""
    true = {"young": 2e5, "poisson": 0.4995}
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    body = jf.SoftBody(mesh, density=1070.0, damping=3e-3, fixed="x-", strain="smoothed", name="b", **true)
    model, params, state = jf.build(jf.Scene([body]), scheme="generalized_alpha")
    places = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "middle": (0.05, 0.015, 0.03)}
    recording = recorded(model, params, state, places, 1e-2, 24, 5e-5)
    take = Take(model, params, state, recording, places, 1e-2, compare="position", release=0.0)
    start = {"shear_modulus": 1e5, "bulk_modulus": 1e6}
    result = fit_takes([take], parameters=list(start), starts=[start], search=QUICK)
    shear, bulk = 2e5 / 2.999, 2e5 / 0.003
    assert result.values["shear_modulus"] == pytest.approx(shear, rel=0.01)
    low, high = result.intervals["bulk_modulus"]
    assert high == np.inf and 3 * shear < low < bulk
    assert f"at least {low:.5g}" in result.summary() and any("one side alone" in text for text in result.warnings)


def test_groups_of_elements_have_constants_of_their_own():
    """By path: only these elements change, in proportion; the rest stays."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    model, params, state = jf.build(jf.Scene([jf.SoftBody(mesh, 2e5, 0.3, 1000.0, fixed="x-")]))
    half = np.arange(model.elements.count // 2)
    known = group_constants({"stiff": half}, model)
    assert set(known) == {f"{name}.stiff" for name in ("young", "poisson", "damping", "density")}
    young = known["young.stiff"]
    assert value_of(young, params, state) == pytest.approx(2e5) and young.unit == "Pa" and young.stiffness
    changed, _ = with_all(params, state, {"young.stiff": jnp.asarray(8e5)}, (young,))
    assert np.asarray(changed.young).tolist() == [8e5] * len(half) + [2e5] * (model.elements.count - len(half))
    again, _ = with_all(changed, state, {"young.stiff": jnp.asarray(4e5)}, (young,))
    assert float(again.young[0]) == pytest.approx(4e5) and float(again.young[-1]) == pytest.approx(2e5)
    stepped, info = jf.step(model, changed, state, 1e-2)
    assert int(info.status) == 0 and np.isfinite(stepped.positions).all()
    for rows in ([], [-1], [0, 0], [0.5], [model.elements.count]):
        with pytest.raises(FitError, match='group "stiff" is'):
            group_constants({"stiff": rows}, model)


@pytest.mark.slow
def test_moduli_of_two_groups_come_back_within_their_bars():
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1))
    body = jf.SoftBody(mesh, 2e5, 0.35, 1070.0, damping=3e-3, fixed="x-", name="b")
    model, params, state = jf.build(jf.Scene([body]), scheme="generalized_alpha")
    near = mesh.points[mesh.cells].mean(axis=1)[:, 0] < 0.05
    true = params.replace(young=jnp.where(near, 4e5, 2e5))
    places = {"tip": (0.1, 0.015, 0.03), "left": (0.1, 0.0, 0.01), "middle": (0.05, 0.015, 0.03)}
    recording = recorded(model, true, state, places, 1e-2, 24, 2e-5)
    groups = {"near": np.flatnonzero(near), "far": np.flatnonzero(~near)}
    take = Take(model, params, state, recording, places, 1e-2, release=0.0, groups=groups)
    found = fit_takes([take], parameters=("young.near", "young.far"), search=QUICK)
    for name, value in (("young.near", 4e5), ("young.far", 2e5)):
        assert abs(found.values[name] - value) < 3.5 * found.standard_errors[name] < 0.3 * value
