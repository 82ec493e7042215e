"""Numbers that cannot be get a status that names them, wherever they stand; a state that is not finite never passes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.ranges import ranges_of
from jaxfem.solvers import Status, describe
from jaxfem.stepping.values import value_status

BAD = (float("nan"), float("inf"), -1.0)


@pytest.fixture(scope="module")
def everything():
    """A soft bar with loads, a rigid body on a motor, others on a rope, on the ground and on a motion; and the look."""
    bar = jf.SoftBody(
        jf.mesh.box((0.2, 0.1, 0.1), (1, 1, 1)),
        young=1e5,
        poisson=0.3,
        density=1e3,
        damping=1e-3,
        fixed="x-",
        loads=[jf.NodalForce("x+", (0, 0, -1)), jf.Pressure("x+", 1.0)],
        name="bar",
    )
    wheel = jf.RigidBody(jf.Sphere(0.05), mass=0.5, position=(1, 0, 1), name="wheel")
    ball = jf.RigidBody(jf.Sphere(0.1), mass=0.5, position=(2, 0, 0.1), name="ball")
    crank = jf.RigidBody(jf.Sphere(0.1), mass=0.5, position=(3, 0, 0), name="crank", motion=jf.Motion((0.1, 0, 0)))
    hinge = jf.HingeJoint(None, wheel, (1, 0, 1), (0, 1, 0), low=-1, high=1, motor=jf.Motor(1.0, 0.1), name="axle")
    rope = jf.DistanceJoint(wheel, ball, (1, 0, 1), (2, 0, 0.1), rope=True, name="rope")
    scene = jf.Scene(
        [bar, wheel, ball, crank], joints=[hinge, rope], contacts=[jf.Contact(ball, jf.Plane(), name="on")]
    )
    model, params, state = jf.build(scene)
    return (model, params, state), jax.jit(lambda *given: value_status(model, *given))


@pytest.fixture(scope="module")
def free():
    """Rigid bodies without any row, and a step of theirs."""
    bodies = [jf.RigidBody(jf.Box((0.1, 0.2, 0.3)), mass=1.0, position=(i, 0, 0), name=f"box {i}") for i in range(2)]
    built = jf.build(jf.Scene(bodies))
    return built, jax.jit(lambda params, state, dt: jf.step(built[0], params, state, dt))


def told(status):
    """The info of one step."""
    return jf.StepInfo(*map(jnp.asarray, (status, 1, 0.0, 0, 0)))


def leaves(tree):
    """Where each array of numbers is, and what the others are put in for."""
    paths, treedef = jax.tree_util.tree_flatten_with_path(tree)
    for at, (path, leaf) in enumerate(paths):

        def put(value, at=at, leaf=leaf):
            flat = [each for _, each in paths]
            flat[at] = jnp.asarray(leaf).at[(-1,) * jnp.ndim(leaf)].set(value)
            return jax.tree.unflatten(treedef, flat)

        yield jax.tree_util.keystr(path), put


def test_every_number_of_params_is_looked_at(everything):
    (_, params, state), look = everything
    still = jnp.zeros_like(state.positions)
    assert int(look(params, state, 1e-2, still)) == 0
    count = 0
    for path, put in leaves(params):
        status = look(put(jnp.nan), state, 1e-2, still)
        assert Status(int(status)) is Status.INVALID_VALUE, path
        last = path.rsplit(".", 1)[-1].split("[")[0] if not path.startswith(".constants") else path.split("'")[1]
        assert last in describe(status), path
        count += 1
    assert count == len(jax.tree.leaves(params)) > 25


@pytest.mark.parametrize("name", ["dt", "forces", "young", "poisson", "damping", "density", "friction", "restitution"])
def test_values_out_of_range_are_named(everything, name):
    (model, params, state), look = everything
    (label,) = model.contacts
    for bad in BAD:
        given, dt, forces = params, 1e-2, jnp.zeros_like(state.positions)
        if name == "dt":
            dt = bad
        elif name == "forces":
            if bad < 0:
                continue
            forces = forces.at[0].set(bad)  # of a fixed node
            assert float(model.free[0]) == 0
        elif name in params.constants:
            given = params.replace(**{name: jnp.full_like(params.constants[name], bad)})
        else:
            values = params.contacts[label]
            spoiled = values.replace(**{name: jnp.full_like(getattr(values, name), bad)})
            given = params.replace(contacts={label: spoiled})
        status = look(given, state, dt, forces)
        assert Status(int(status)) is Status.INVALID_VALUE and name in describe(status), (name, bad)
    if name == "poisson":
        assert "0.5" in describe(look(params.replace(poisson=jnp.array([0.5])), state, 1e-2, forces))


def test_numbers_that_cannot_be_together_are_named(everything):
    """Limits that cross; constants of a law: `tests/materials/test_nonsense.py`."""
    (model, params, state), look = everything
    still = jnp.zeros_like(state.positions)
    (label,) = [name for name in params.joints if "limit" in name]
    crossed = params.joints[label].replace(low=jnp.full(1, 0.5), high=jnp.full(1, -0.5))
    given = params.replace(joints={**params.joints, label: crossed})
    status = look(given, state, 1e-2, still)
    assert f'joints["{label}"].high - low must not be negative: these limits cross' in describe(status)
    assert 'high - low of joint "axle" is -1' in str(jf.diagnose(model, given, state, told(status)))
    beyond = params.joints[label].replace(high=jnp.full(1, 4.0))
    given = params.replace(joints={**params.joints, label: beyond})
    assert f'joints["{label}"].high must be within -pi and pi' in describe(look(given, state, 1e-2, still))
    off = params.joints[label].replace(low=jnp.full(1, jnp.inf), high=jnp.full(1, jnp.inf))  # an infinite limit is off
    assert int(look(params.replace(joints={**params.joints, label: off}), state, 1e-2, still)) == 0


def test_the_first_of_several_is_named_and_the_others_are_found(everything):
    (model, params, state), look = everything
    given = params.replace(young=jnp.zeros(1), density=-jnp.ones(1))
    status = look(given, state, -1.0, jnp.zeros_like(state.positions))
    assert "dt" in describe(status)
    found = jf.diagnose(model, given, state, told(status))
    assert not found.ok and found.status is Status.INVALID_VALUE
    assert [each.name for each in found.findings if each.kind == "invalid"] == ["young", "density"]
    assert 'young of body "bar" is 0: it must be > 0 Pa' in str(found) and "time step" in str(found)


def test_diagnose_says_whose_value_it_is(free, everything):
    (model, params, state), step = free
    given = params.replace(rigid=params.rigid.replace(mass=params.rigid.mass.at[1].set(0.0)))
    text = str(jf.diagnose(model, given, *step(given, state, 1e-2)))
    assert 'rigid.mass of body "box 1" is 0: it must be more than 0' in text
    (model, params, state), _ = everything
    (label,) = [name for name in params.joints if "motor" in name]
    weak = params.joints[label].replace(strength=-jnp.ones(1))
    given = params.replace(joints={**params.joints, label: weak})
    text = str(jf.diagnose(model, given, state, told(0)))
    assert f'joints["{label}"].strength of joint "axle" is -1' in text


def test_a_rigid_state_that_is_not_finite_is_named_without_rows_too(free):
    (_, params, state), step = free
    for path, put in leaves(state.replace(positions=None, velocities=None)):
        for bad in BAD[:2]:
            given = put(bad).replace(positions=state.positions, velocities=state.velocities)
            status = step(params, given, 1e-2)[1].status
            assert Status(int(status)) is Status.INVALID_VALUE, path
            assert path.rsplit(".", 1)[-1] in describe(status)
    still = state.rigid.replace(orientations=state.rigid.orientations.at[0].set(0))
    assert "quaternions" in describe(step(params, state.replace(rigid=still), 1e-2)[1].status)


def test_a_run_that_leaves_the_finite_numbers_says_so(free):
    (model, params, state), _ = free
    fast = state.replace(rigid=state.rigid.replace(velocities=state.rigid.velocities.at[0].set(1e307)))
    states, infos = jf.rollout(model, params, fast, 100.0, 3)  # positions pass the largest number
    assert not np.isfinite(states.rigid.positions[-1]).all()
    assert int(infos.status[-1]) == Status.NOT_FINITE
    varying = jnp.zeros((3, *model.rest.shape))
    assert int(jf.rollout(model, params, state, 1e-2, 3, forces=varying)[1].status.sum()) == 0


def test_soft_bodies_are_looked_at_in_each_step():
    body = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), (1, 1, 1)), young=1e5, poisson=0.3, density=1e3, fixed="x-")
    model, params, state = jf.build(jf.Scene([body]))
    node = int(jnp.argmin(model.free))
    varying = jnp.zeros((3, *model.rest.shape)).at[1, node, 0].set(jnp.inf)  # where it moves nothing
    run = jax.jit(lambda params, forces: jf.rollout(model, params, state, 1e-2, 3, forces=forces)[1].status)
    status = run(params, varying)
    assert int(status[0]) == 0 and "forces" in describe(status[1])
    assert all("young" in describe(each) for each in run(params.replace(young=-params.young), varying))


def test_a_batch_names_its_bad_lane(free):
    (_, params, state), step = free
    masses = jnp.array([[1.0, 1.0], [1.0, jnp.inf], [2.0, 1.0]])
    status = jax.vmap(lambda m: step(params.replace(rigid=params.rigid.replace(mass=m)), state, 1e-2)[1].status)(masses)
    assert [int(each) == 0 for each in status] == [True, False, True]
    assert describe(status) == f"2 of 3: converged; 1 of 3: {describe(status[1])}" and "rigid.mass" in describe(status)


def test_derivatives_do_not_see_the_looks(free):
    (_, params, state), step = free

    def fall(gravity):
        return step(params.replace(gravity=gravity), state, 1e-2)[0].rigid.positions[0, 2]

    np.testing.assert_allclose(jax.grad(fall)(params.gravity), [0, 0, 1e-4], rtol=1e-12)


def with_values(params, kind, word, **changes):
    """Params with other values of the group of rows whose name has that word."""
    groups = getattr(params, kind)
    (label,) = [name for name in groups if word in name]
    return params.replace(**{kind: {**groups, label: groups[label].replace(**changes)}})


def moved(params, **changes):
    (motion,) = params.rigid.motions
    return params.replace(rigid=params.rigid.replace(motions=(motion.replace(**changes),)))


WRONG = [
    (
        lambda p: with_values(p, "contacts", "plane", friction=0.3),
        r'contacts\["rough .*"\].friction has shape \(\)',
    ),
    (lambda p: with_values(p, "contacts", "plane", friction=np.ones((1, 1))), r"friction has shape \(1, 1\)"),
    (
        lambda p: with_values(p, "contacts", "plane", separation=None),
        "separation is None; give an array",
    ),
    (lambda p: with_values(p, "joints", "limit", low=np.zeros(2)), r'joints\["angle limit .*"\].low has shape \(2,\)'),
    (lambda p: with_values(p, "joints", "limit", high=1j), r'joints\["angle limit .*"\].high is 1j; give a real'),
    (lambda p: p.replace(contacts=dict.fromkeys(p.contacts)), r"params.contacts\[.* is None where .* a ContactValues"),
    (lambda p: p.replace(joints={}), r"params.joints holds \[\]; the scene's groups are \['angle limit"),
    (lambda p: p.replace(young="a"), "young is 'a'; give a real number"),
    (lambda p: p.replace(young="1e5"), "young is '1e5'; give a real number"),
    (lambda p: p.replace(young=None), "young is None; give one number, one for each of the 1 bodies"),
    (lambda p: p.replace(young=np.array(1j)), "young is .*j.; give a real number"),
    (lambda p: p.replace(young={"bar": 1e5}), "young is a dict; give one number, one"),
    (lambda p: p.replace(young=jax.random.key(0)), "young is an array .*key.*; give a real number"),
    (lambda p: p.replace(constants=None), "params hold the constants None; the scene's materials have"),
    (lambda p: p.replace(gravity=(0, 0, "down")), r"gravity\[2\] is 'down'; give a real number"),
    (lambda p: p.replace(gravity=None), "gravity is None; give three numbers"),
    (lambda p: p.replace(loads=(None, p.loads[1])), r"loads\[0\] is None; give three numbers"),
    (lambda p: p.replace(loads=(p.loads[0], np.zeros(3))), r"loads\[1\] has shape \(3,\); give one number"),
    (lambda p: p.replace(loads=(np.zeros((5, 3)), p.loads[1])), r"loads\[0\] has shape \(5, 3\)"),
    (lambda p: p.replace(loads=None), "params.loads is None; give a tuple of 2 values"),
    (lambda p: p.replace(rigid=p.rigid.replace(mass=0.5)), r"rigid.mass has shape \(\); give three numbers"),
    (lambda p: moved(p, velocity=1.0), r"rigid.motions\[0\].velocity has shape \(\); give three numbers"),
    (lambda p: moved(p, frequency="fast"), r"rigid.motions\[0\].frequency is 'fast'; give a real number"),
]


@pytest.mark.parametrize(("change", "text"), WRONG)
def test_what_has_another_shape_or_is_no_number_is_named_before_anything_is_compiled(everything, change, text):
    (model, params, state), _ = everything
    for call in (lambda p: jf.step(model, p, state, 1e-2), lambda p: jf.rollout(model, p, state, 1e-2, 2)):
        with pytest.raises(jf.StepError, match=text):
            call(change(params))


def test_times_states_and_forces_that_are_no_numbers_are_named(free):
    (model, params, state), _ = free
    for change, text in (({"dt": "a"}, "dt is 'a'"), ({"forces": [["a"]]}, "forces is .*; give a real")):
        with pytest.raises(jf.StepError, match=text):
            jf.step(model, params, state, **{"dt": 1e-2, **change})
    with pytest.raises(jf.StepError, match=r"state\.rigid\.velocities is 1j"):
        jf.step(model, params, state.replace(rigid=state.rigid.replace(velocities=1j)), 1e-2)


@pytest.mark.filterwarnings("error")
def test_what_single_precision_cannot_hold_is_named_with_its_value():
    body = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), young=1e5, poisson=0.3, density=1e3, fixed="x-")
    model, params, state = jf.build(jf.Scene([body]), dtype=np.float32)
    for change, text in (
        (
            {"young": 1e39},
            r"young is 1e\+39, more than float32 holds .3.4e\+38 .*: .*, or build with dtype =",
        ),
        ({"young": np.full(6, 1e39)}, "young is .*, more than float32 holds"),
        ({"gravity": (0, 0, -1e300)}, r"gravity is \(0, 0, -1e\+300\), more than float32 holds"),
        ({"young": 10**400}, "young is .*, more than float32 holds"),
    ):
        with pytest.raises(jf.StepError, match=text):
            jf.step(model, params.replace(**change), state, 1e-2)
    info = jf.step(model, params.replace(young=float("nan")), state, 1e-2)[1]
    assert "young must be > 0 Pa" in describe(info.status)


def test_shapes_that_serve_as_well_pass_in_lanes_too(everything):
    """One force a node for one on all, values in a list, and lanes of values, whose shapes are those of one."""
    (model, params, state), _ = everything
    shared, pressure = params.loads
    nodes = len(model.loads[0].nodes)
    whole = jf.step(model, params, state, 1e-3)[0].positions
    each = params.replace(loads=[jnp.tile(shared, (nodes, 1)), pressure])
    np.testing.assert_allclose(jf.step(model, each, state, 1e-3)[0].positions, whole, atol=1e-14)
    friction = jnp.asarray([[0.2], [0.3]])

    def stepped(own):
        return jf.step(model, with_values(params, "contacts", "plane", friction=own), state, 1e-3)[1].status

    assert not jax.vmap(stepped)(friction).any()
    with pytest.raises(jf.StepError, match=r"friction has shape \(\)"):
        jax.vmap(stepped)(friction[:, 0])


def test_names_are_those_of_python(everything):
    (_, params, _), _ = everything
    for name, value, _ in ranges_of(params):
        assert np.shares_memory(np.asarray(eval(f"params.{name}", {"params": params})), np.asarray(value))
