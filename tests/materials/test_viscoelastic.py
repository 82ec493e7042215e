"""The Prony series against closed forms, on every kind of domains, with both schemes and both routes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check
from scipy.linalg import expm

import jaxfem as jf
from jaxfem.energies import total_elastic_energy
from jaxfem.io import SceneFileError, load_scene
from jaxfem.model import nodal_mass
from jaxfem.stepping.begin import begun

BRANCHES = [(0.4, 0.02), (0.25, 0.3)]
ELASTIC = {"young": 2e5, "poisson": 0.3, "damping": 1e-3}
FULL, DEVIATORIC = slice(0, 6), slice(1, 6)
POINTS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.02, 0.03, 0.1]])


def law_of(part="all", branches=BRANCHES, **values):
    return jf.Viscoelastic(**{**ELASTIC, **values}, branches=branches, part=part)


def block(material, strain="element", cells=(1, 1, 1), **settings):
    """A hanging block clamped on one side."""
    mesh = jf.mesh.box((0.1, 0.05, 0.05), cells)
    body = jf.SoftBody(mesh, density=1e3, material=material, fixed="x-", strain=strain, name="block")
    return jf.build(jf.Scene([body]), **{"tolerance": 1e-12, **settings})


@pytest.mark.parametrize("part", ["all", "deviatoric"])
@pytest.mark.parametrize("dt", [1e-3, 0.1, 50.0])
def test_a_held_strain_relaxes_as_the_series_says_at_any_step(part, dt):
    law = law_of(part)
    strain = jnp.asarray(np.random.default_rng(1).standard_normal((6, 3)))
    memory = law.internal_at_once(law.values, strain)
    for step in range(1, 4):
        factor, offset = law.response(law.values, memory, dt, FULL)
        weights = np.array([factor[0], *[factor[1]] * 5], float)[:, None]
        left = sum(g * np.exp(-step * dt / tau) for g, tau in BRANCHES)
        expected = (1 + left * np.array([part == "all", *[True] * 5], float)[:, None]) * strain
        np.testing.assert_allclose(weights * (strain + offset), expected, rtol=1e-13)
        memory = law.commit(law.values, memory, strain, dt, FULL)
    assert law.internal0(strain).springs[0].shape == ((6, 3) if part == "all" else (5, 3))
    assert (law.internal0(strain[:1]) is None) == (part == "deviatoric")


def test_harmonic_strain_gives_the_storage_and_loss_moduli():
    law, omega, count = law_of(), 20.0, 4000
    dt = 2 * np.pi / omega / count
    strains = jnp.sin(omega * dt * jnp.arange(24 * count + 1))

    def one(memory, strain):
        now = jnp.full((5, 1), strain)
        factor, offset = law.response(law.values, memory, dt, DEVIATORIC)
        return law.commit(law.values, memory, now, dt, DEVIATORIC), (factor[1] * (now + offset))[0, 0]

    _, stress = jax.lax.scan(one, law.internal0(jnp.zeros((5, 1))), strains[1:])
    shear = law.stiffness(law.values)[1] / 2
    last, phase = shear * np.asarray(stress[-count:]), omega * dt * np.arange(23 * count + 1, 24 * count + 1)
    storage, loss = law.storage_and_loss(jnp.asarray([omega]), "shear")
    np.testing.assert_allclose(2 * np.mean(last * np.sin(phase)), storage[0], rtol=1e-6)
    np.testing.assert_allclose(2 * np.mean(last * np.cos(phase)), loss[0] - shear * omega * 1e-3, rtol=1e-5)
    still, fast = law.storage_and_loss(jnp.asarray([0.0, 1e9]))[0]
    np.testing.assert_allclose([still, fast], [2e5, 2e5 * (1 + sum(g for g, _ in BRANCHES))], rtol=1e-12)
    stiff = law_of("deviatoric", poisson=0.499).storage_and_loss(1e9)[0]  # hardly any volume to change: E = 3 mu
    np.testing.assert_allclose(stiff, 2e5 * 1.65, rtol=1e-3)
    assert (
        law.storage_and_loss(omega, "bulk")[1] > 0
        and law_of("deviatoric", damping=0.0).storage_and_loss(1.0, "bulk")[1] == 0
    )
    with pytest.raises(jf.MaterialError, match="modulus is 'storage'; give one of 'young', 'shear', 'bulk'"):
        law.storage_and_loss(1.0, "storage")


def exact(model, params, u0, time):
    """Displacements (m,) of free nodes after `time`, from u0 at rest with relaxed springs: the linear system's own."""
    free = np.flatnonzero(np.repeat(np.asarray(model.free) > 0, 3))
    with_it = jax.hessian(lambda x: total_elastic_energy(model, params, x.reshape(-1, 3)))(model.rest.ravel())
    stiff = np.asarray(with_it)[np.ix_(free, free)] / np.repeat(nodal_mass(model, params.density), 3)[free][:, None]
    n, eye = len(free), np.eye(len(free))
    whole = np.zeros((4 * n, 4 * n))  # u, v, springs
    whole[:n, n : 2 * n] = eye
    whole[n : 2 * n, :n], whole[n : 2 * n, n : 2 * n] = -stiff, -ELASTIC["damping"] * stiff
    for k, (g, tau) in enumerate(BRANCHES, 2):
        own = slice(k * n, (k + 1) * n)
        whole[n : 2 * n, own], whole[own, n : 2 * n], whole[own, own] = -g * stiff, eye, -eye / tau
    start = np.concatenate([u0[free], np.zeros(3 * n)])
    return (expm(time * whole) @ start)[:n], free


@functools.cache
def swings(strain, scheme):
    """Error of tiny free swings against the closed form, as a function of the steps in 0.1 s."""
    model, params, state = block(law_of(), strain, scheme=scheme)
    params = params.replace(gravity=jnp.zeros(3))
    u0 = 1e-8 * np.random.default_rng(0).standard_normal(model.rest.shape) * np.asarray(model.free)[:, None]
    expected, free = exact(model, params, u0.ravel(), 0.1)
    start = jf.with_memory(model, params, state.replace(positions=model.rest + u0), "relaxed")

    @jax.jit
    def end(steps):
        dt = 0.1 / steps
        first = begun(model, params, start, None)  # as steps leave it: the loop's body holds the only step
        return jax.lax.fori_loop(0, steps, lambda _, s: jf.step(model, params, s, dt)[0], first).positions

    def error(steps):
        found = np.asarray(end(steps) - model.rest).ravel()[free]
        return np.linalg.norm(found - expected) / np.linalg.norm(u0)

    return error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strain", "scheme", "order"),
    [
        ("element", "generalized_alpha", 2),
        ("smoothed", "generalized_alpha", 2),
        ("nodal_volume", "backward_euler", 1),
    ],
)
def test_free_swings_converge_to_the_closed_form_at_the_schemes_order(strain, scheme, order):
    counts = (200, 400, 800) if order == 2 else (800, 1600, 3200)
    errors = [swings(strain, scheme)(n) for n in counts]
    found = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(found - order) < 0.1, (found, errors)


def test_without_branches_it_is_the_linear_law_bit_for_bit():
    plain, none = block(jf.Linear(**ELASTIC)), block(law_of(branches=0))
    assert none[2].internal is None and set(none[1].constants) == set(plain[1].constants)
    ends = [jf.rollout(*scene, 1e-2, 5)[0] for scene in (plain, none)]
    np.testing.assert_array_equal(*(each.positions for each in ends))
    np.testing.assert_array_equal(*(each.velocities for each in ends))


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_lanes_are_runs_of_their_own_and_derivatives_hold(strain):
    model, params, state = block(law_of("deviatoric"), strain, scheme="generalized_alpha")

    def tip(g_1=0.4, tau_1=0.02, g_2=0.25, tau_2=0.3, young=1.0):
        own = params.replace(g_1=g_1, tau_1=tau_1, g_2=g_2, tau_2=tau_2, young=2e5 * young)
        return 1e3 * jf.rollout(model, own, state, 1e-2, 4)[0].positions[-1, -1, 2]

    others = (0.02, 0.25, 0.3, 1.0)
    run = check(tip, (0.4, *others), h=1e-3 * 0.02, forwards=strain == "element")
    shares = jnp.array([0.1, 0.4, 0.9])
    np.testing.assert_allclose(jax.jit(jax.vmap(tip))(shares), [run(each, *others) for each in shares], atol=1e-9)


@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_rows_solved_as_rows_give_the_same_steps(strain):
    routes = [block(law_of("deviatoric"), strain, solver=solver) for solver in ("condensed", "mprgp")]
    ends = [jf.rollout(*scene, 1e-2, 4)[0].positions for scene in routes]
    np.testing.assert_allclose(*ends, atol=1e-10)


def test_it_creeps_to_the_relaxed_shape_and_starts_as_told():
    body = jf.SoftBody(jf.TetMesh(POINTS, [[0, 1, 2, 3]]), density=1e3, material=law_of(), fixed=[0, 1, 2])
    scene = model, params, _ = jf.build(jf.Scene([body]), tolerance=1e-12)
    rest, info = jf.equilibrium(*scene)
    assert int(info.status) == 0 and np.abs(rest.internal[0].strain).max() > 1e-5
    states, info = jf.rollout(*scene, 0.1, 60)
    assert not info.status.any() and info.counts is None
    np.testing.assert_allclose(states.positions[-1], rest.positions, atol=1e-9)
    assert np.abs(states.positions[3] - rest.positions).max() > 1e-7  # not at once
    still = jf.step(model, params, rest, 1e-2)[0]
    np.testing.assert_allclose(still.positions, rest.positions, atol=1e-12)
    pushed = jf.step(model, params, jf.with_memory(model, params, rest, "instantaneous"), 1e-2)[0]
    assert np.abs(pushed.positions - rest.positions).max() > 1e-8
    with pytest.raises(jf.StepError, match="start is 'old'; give one of 'relaxed', 'instantaneous'"):
        jf.with_memory(*scene, "old")


@pytest.mark.slow
def test_bodies_that_are_struck_take_their_step_by_another_scheme():
    """Some domains are then asked at the end of the step, others within it: with no share, all as the linear law."""
    mesh = jf.mesh.box((0.1, 0.1, 0.1), 1, origin=(0, 0, 0.005))
    ends = []
    for law in (jf.Linear(**ELASTIC), law_of("deviatoric", [(0.0, 0.02)]), law_of("deviatoric", [(0.5, 0.02)])):
        body = jf.SoftBody(mesh, density=1e3, material=law)
        scene = jf.Scene([body], contacts=[jf.Contact(body, jf.Plane())])
        states, info = jf.rollout(*jf.build(scene, scheme="generalized_alpha", tolerance=1e-11), 5e-3, 20)
        assert not info.status.any()
        ends.append(np.asarray(states.positions))
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-10)
    assert np.abs(ends[2] - ends[0]).max() > 1e-6


def test_single_precision_keeps_up_with_double():
    ends = [
        jf.rollout(*block(law_of("deviatoric"), dtype=dtype, tolerance=tol), 1e-2, 8)[0].positions
        for dtype, tol in ((jnp.float32, 1e-6), (jnp.float64, 1e-12))
    ]
    assert ends[0].dtype == jnp.float32
    np.testing.assert_allclose(*ends, atol=1e-6)


SCENE = """
[time]
step = 0.01
steps = 4
[[body]]
name = "beam"
mesh = { box = [0.1, 0.03, 0.03], cells = [1, 1, 1] }
material = "viscoelastic"
young = 1e5
poisson = 0.3
density = 1000.0
branches = 2
g_1 = 0.1
tau_1 = 0.02
g_2 = 0.3
tau_2 = 1.0
"""


def test_scene_files_give_any_number_of_branches(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    model, params, state = load_scene(path).build()
    assert (
        model.laws[0] == law_of("deviatoric").law and float(params.tau_2) == 1 and len(state.internal[0].springs) == 2
    )
    assert model.constants["tau_2"].unit == "s"
    wrong = {
        "g_2 = 0.3\n": ("", "missing key 'g_2'"),
        "branches = 2": ("branches = 1", "unknown key 'g_2' in"),
        "tau_2 = 1.0": ("tau_2 = 0.0", 'tau_2 of "beam" is 0: it must be > 0 s'),
        "material": ('part = "bulk"\nmaterial', "part is 'bulk'; what relaxes is one of"),
    }
    for old, (new, text) in wrong.items():
        path.write_text(SCENE.replace(old, new))
        with pytest.raises((SceneFileError, jf.MaterialError), match=text):
            load_scene(path)


def test_what_cannot_be_is_refused():
    assert law_of(branches=np.array(BRANCHES)) == law_of() and law_of(branches=np.int64(0)).branches == 0
    for given, text in (
        ({"branches": -1}, "branches is -1; give how many branches relax, 0 or more"),
        ({"branches": [0.1, 0.2]}, "give pairs"),
        ({"branches": 1, "g_1": 0.1}, "Viscoelastic needs tau_1, its relaxation time of branch 1 in s"),
        ({"branches": [(0.1, 0.2)], "part": "volume"}, "part is 'volume'"),
        ({"branches": [(0.1, 0.2)], "g_2": 0.1}, "Viscoelastic has no constant 'g_2'; it has .*tau_1, branches, part"),
    ):
        with pytest.raises(jf.MaterialError, match=text):
            jf.Viscoelastic(**ELASTIC, **given)
