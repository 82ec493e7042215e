"""`diagnose` names the step, the body, the joint or contact that is wrong, and what to do; or says that all is well."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

STEPS = 5
FALLING = [
    jf.SoftBody(
        jf.mesh.box((0.2, 0.1, 0.1), (2, 1, 1)).translated((0, 0, z)),
        young=1e5,
        poisson=0.3,
        density=1e3,
        name=name,
        fixed="x-",
    )
    for z, name in ((0, "lower"), (1, "upper"))
]


@pytest.fixture(scope="module")
def hanging():
    """A ball on a ball joint under a fixed block, and another that lies on the ground: a run that converges."""
    block = jf.RigidBody(jf.Box((0.1, 0.1, 0.1)), mass=1.0, position=(0, 0, 1), fixed=True, name="block")
    bob = jf.RigidBody(jf.Sphere(0.05), mass=0.5, position=(0, 0, 0.5), name="bob")
    ball = jf.RigidBody(jf.Sphere(0.1), mass=0.5, position=(1, 0, 0.1), name="ball")
    scene = jf.Scene(
        [block, bob, ball],
        joints=[
            jf.BallJoint(bob, block, (0, 0, 0.95), name="hook"),
            jf.DistanceJoint(bob, ball, (0, 0, 0.5), (1, 0, 0.1), rope=True, name="leash"),
        ],
        contacts=[jf.Contact(ball, jf.Plane(), name="floor")],
    )
    built = jf.build(scene)
    return *built, *jf.rollout(*built, 1e-2, STEPS)


@pytest.fixture(scope="module")
def soft():
    """Two soft boxes, one above the other, that nothing ties."""
    return jf.build(jf.Scene(FALLING))


def told(status=0, iterations=3):
    """The info of one step."""
    return jf.StepInfo(*map(jnp.asarray, (status, iterations, 1e-9, 0, 0)))


def at(index, tree):
    return jax.tree.map(lambda leaf: leaf[index], tree)


def test_a_run_that_converged_says_so_in_one_line(hanging):
    model, params, _, states, infos = hanging
    found = jf.diagnose(model, params, states, infos)
    assert found.ok and found.step is None and found.findings == ()
    assert str(found).startswith("all 5 steps converged (at most ") and "\n" not in str(found)
    assert 'at the end joint "' in str(found) and found.text.count("is open by") == 1
    one = jf.diagnose(model, params, at(-1, states), at(-1, infos))
    assert one.ok and str(one).startswith("the step converged")
    assert jf.diagnose(model, params, at(-1, states), infos).ok  # a run's infos with its last state


def test_a_body_that_is_lost_is_named_with_its_step(hanging):
    model, params, _, states, infos = hanging
    spoiled = states.rigid.replace(velocities=states.rigid.velocities.at[3:, 2].set(jnp.nan))
    found = jf.diagnose(model, params, states.replace(rigid=spoiled), infos)
    assert not found.ok and found.step == 4
    lines = str(found).splitlines()
    assert lines[0] == "step 4 of 5 (t = 0.04 s) failed, the first of 2: not finite"
    assert 'body "ball" is not finite any more: its place or velocity' in lines[1]
    assert "next: take a smaller time step" in str(found)
    assert [each.name for each in found.findings if each.kind == "not finite"] == ["ball"]
    assert all("bob" not in line for line in lines if "not finite" in line)


def test_a_nan_in_one_soft_body_is_counted(soft):
    model, params, state = soft
    node = int(model.body_nodes("upper")[3])
    found = jf.diagnose(model, params, state.replace(positions=state.positions.at[node, 1].set(jnp.inf)), told(2))
    assert found.step == 1 and found.findings[0][:3] == ("not finite", "upper", 1)
    assert f"1 of its {model.nodes // 2} nodes" in str(found) and "lower" not in str(found)


def test_elements_inside_out_are_found_by_body(soft):
    model, params, state = soft
    upper = model.body_nodes("upper")
    tip = upper[jnp.argmax(model.rest[upper].sum(1))]
    moved = state.positions.at[tip].add(jnp.array([-0.3, 0.0, 0.0]))
    found = jf.diagnose(model, params, state.replace(positions=moved), told())
    assert not found.ok and found.step is None
    (only,) = found.findings
    cells, owner = np.asarray(model.elements.cells), np.asarray(model.elements.body)
    inside_out = np.linalg.det(moved[cells][:, 1:] - moved[cells][:, :1]) <= 0
    assert only.kind == "inverted" and only.name == "upper" and only.amount == inside_out.sum() > 0
    assert (owner[inside_out] == 1).all() and "finer mesh" in str(found) and "-" in only.text.split("at ")[1]
    assert str(found).startswith("every step converged, but this looks wrong:")


def test_the_fastest_body_of_a_failed_step_is_named_and_the_remedy_told(soft):
    model, params, state = soft
    slow = state.velocities.at[model.body_nodes("upper")].set(jnp.array([0.0, 0.0, -2.0]))
    slow = slow.at[model.body_nodes("lower")].set(jnp.array([3.0, 4.0, 0.0]))
    found = jf.diagnose(model, params, state.replace(velocities=slow), told(1, 20_000))
    assert found.status is jf.solvers.Status.ITERATION_LIMIT and found.step == 1
    assert str(found).startswith("the step (t = 0 s) failed: iteration limit")
    assert "raise max_iterations" in str(found) and 'body "lower" is the fastest, 5 m/s' in str(found)


def test_a_joint_that_came_open_is_named_with_its_gap(hanging):
    model, params, state, *_ = hanging
    pulled = state.rigid.replace(positions=state.rigid.positions.at[1, 2].add(-0.03))
    found = jf.diagnose(model, params, state.replace(rigid=pulled), told())
    (only,) = found.findings
    assert (only.kind, only.name) == ("open", "hook") and only.amount == pytest.approx(0.03)
    assert 'joint "hook" is open by 0.03 m' in str(found) and "compliance" not in str(found)
    softer = {name: each.replace(compliance=each.compliance + 1e-3) for name, each in params.joints.items()}
    again = jf.diagnose(model, params.replace(joints=softer), state.replace(rigid=pulled), told())
    assert again.findings[0].amount == pytest.approx(0.03) and "it has a compliance" in str(again)


def test_a_rope_is_open_only_where_it_is_too_long(hanging):
    model, params, state, *_ = hanging
    away = state.rigid.replace(positions=state.rigid.positions.at[2].set(jnp.array([3.0, 0.0, 0.5])))
    (only,) = jf.diagnose(model, params, state.replace(rigid=away), told()).findings
    assert only.name == "leash" and only.amount == pytest.approx(3 - np.hypot(1, 0.4))


def test_a_deep_contact_is_named(hanging):
    model, params, state, *_ = hanging
    sunk = state.rigid.replace(positions=state.rigid.positions.at[2, 2].set(0.02))
    found = jf.diagnose(model, params, state.replace(rigid=sunk), told()).findings
    assert [each.name for each in found] == ["leash", "floor"]  # which came to hang on the rope as well
    assert found[1].kind == "deep" and found[1].amount == pytest.approx(0.08) and "start inside" in found[1].advice


def test_a_hinge_is_open_by_an_angle_and_its_motor_is_no_gap():
    wheel = jf.RigidBody(jf.Box((0.2, 0.2, 0.02)), mass=1.0, position=(0, 0, 0), name="wheel")
    hinge = jf.HingeJoint(wheel, None, (0, 0, 0), axis=(0, 0, 1), motor=jf.Motor(5.0, 1.0), name="axle")
    model, params, state = jf.build(jf.Scene([wheel], joints=[hinge]))
    assert jf.diagnose(model, params, state, told()).ok
    for axis, open_ in ((3, False), (1, True)):  # a turn about the axle is free, one across it is not
        turned = jnp.zeros(4).at[0].set(np.cos(0.1)).at[axis].set(np.sin(0.1))
        rigid = state.rigid.replace(orientations=turned[None])
        found = jf.diagnose(model, params, state.replace(rigid=rigid), told())
        assert found.ok != open_
    assert found.findings[0].name == "axle" and "open by 0.2 rad" in str(found)


def test_what_it_does_not_take(hanging):
    model, params, state, states, infos = hanging
    with pytest.raises(jf.StepError, match="the order is"):
        jf.diagnose(model, params, told(), state)
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), (states, infos))
    with pytest.raises(jf.StepError, match="of a batch, give one lane"):
        jf.diagnose(model, params, *batch)
    for wrong in (None, params.constants):
        with pytest.raises(
            jf.StepError, match=rf"got \(Model, {type(wrong).__name__}, State, StepInfo\); the order is"
        ):
            jf.diagnose(model, wrong, states, infos)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_lanes_of_single_steps_are_no_run(soft, dtype):
    model, params, state = soft if dtype == np.float64 else jf.build(jf.Scene(FALLING), dtype=dtype)
    heavier = jnp.asarray([[0, 0, -1.0], [0, 0, -2.0], [0, 0, -3.0]], dtype)
    lanes = jax.vmap(lambda gravity: jf.step(model, params.replace(gravity=gravity), state, 1e-2))(heavier)
    some = lanes[0], lanes[1].replace(status=jnp.asarray([3, 0, 3]))
    for batch in (lanes, some):
        with pytest.raises(jf.StepError, match=r"are at one time, 0.01 s, .*: of a batch, give one lane"):
            jf.diagnose(model, params, *batch)
    assert jf.diagnose(model, params, *at(1, lanes)).ok
    late = state.replace(time=jnp.asarray(1e3, dtype))  # where single precision drops such steps from the time
    assert jf.diagnose(model, params, *jf.rollout(model, params, late, 1e-5, 3)).step is None


def test_a_run_that_stopped_repeats_its_last_state(soft):
    model, params, state = soft
    forces = jnp.zeros((4, *model.rest.shape)).at[1].set(jnp.nan)
    found = jf.diagnose(model, params, *jf.rollout(model, params, state, 1e-2, 4, forces=forces, on_failure="stop"))
    assert found.step == 2


def test_one_saved_step_of_a_run_is_a_run(soft):
    model, params, state = soft
    states, infos = jf.rollout(model, params, state, 1e-2, 1)
    assert jf.diagnose(model, params, states, infos).ok
    assert jf.diagnose(model, params, states, at(0, infos)).ok
