"""Laws that are not linear, or remember: contact, statics and modes, lanes, single precision, points of two slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.elements.elasticity import elastic_force
from jaxfem.materials.principal import slope_of, tangent_of
from jaxfem.model import domain_materials, nodal_mass

SOFT = {"poisson": 0.4, "damping": 1e-2}
FIRM = {"young": 2e5, "poisson": 0.3, "damping": 1e-2}
LAWS = {
    "neo_hookean": jf.NeoHookean(young=6e3, **SOFT),
    "mooney_rivlin": jf.MooneyRivlin(c10=2e3, c01=1e3, **SOFT),
    "j2_plastic": jf.J2Plastic(**FIRM, yield_stress=1e3, isotropic_hardening=4e4, kinematic_hardening=3e4),
    "creep_plastic": jf.CreepPlastic(**FIRM, yield_strain=2e-3, creep=12.0),
    "viscoelastic": jf.Viscoelastic(**FIRM, branches=[(0.4, 0.02), (0.25, 0.3)]),
}


def values_of(law):
    return {name: jnp.asarray(value, float) for name, value in law.values.items()}


def bar(law, cells=(1, 1, 1), loads=(), gravity=(0, 0, -9.81), **build):
    body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), cells), material=law, density=1e3, fixed="x-", loads=list(loads))
    return jf.build(jf.Scene([body], gravity=gravity), **build)


def bars(names, **build):
    """The same of several laws, beside each other."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 1))
    bodies = [
        jf.SoftBody(mesh.translated((0, 0.1 * k, 0)), material=LAWS[name], density=1e3, fixed="x-", name=name)
        for k, name in enumerate(names)
    ]
    return jf.build(jf.Scene(bodies), **build)


@pytest.mark.slow
def test_derivatives_through_contact():
    """A block of rubber on a plane, pressed by its weight: forward = reverse = differences to 1e-6."""
    mesh = jf.mesh.box((0.06, 0.06, 0.06), 1)
    cube = jf.SoftBody(mesh, material=LAWS["neo_hookean"], density=1e3, name="cube")
    scene = jf.Scene([cube], contacts=[jf.Contact("cube", jf.Plane(), friction=0.0)])
    model, params, state = jf.build(scene, tolerance=1e-13)

    def end(young, poisson, density):
        own = params.replace(young=6e3 * young, poisson=0.4 * poisson, density=1e3 * density)
        states, info = jf.rollout(model, own, state, 1e-2, 3)
        return 1e2 * states.positions[-1, -1, 2], (states, info)

    run = check(end, (1.0, 1.0, 1.0), h=1e-3, has_aux=True)
    _, (states, info) = run(1.0, 1.0, 1.0)
    pushed = sum(float(jnp.sum(each[-1])) for each in jf.impulses(model, states).values())
    assert not info.status.any() and pushed > 0


@pytest.mark.slow
def test_rest_and_modes_of_a_stretched_bar():
    """No force is left at rest; frequencies are those of differences of forces at the stretched shape."""
    pull = jf.Traction("x+", (1500.0, 0.0, 200.0))
    model, params, state = bar(LAWS["neo_hookean"], (2, 1, 1), [pull], tolerance=1e-11)
    rest, info = jf.equilibrium(model, params, state)
    assert int(info.status) == 0 and 1.2 < float(rest.positions[:, 0].max()) / 0.1 < 1.6
    materials = domain_materials(model, params)

    @jax.jit
    def force(positions):
        return elastic_force(model.domains, positions, materials)

    free = np.flatnonzero(np.repeat(np.asarray(model.free), 3))
    weight = nodal_mass(model, params.density)[:, None] * params.gravity
    carried = force(rest.positions) + weight + model.loads[0].force(params.loads[0], rest.positions)
    scale = float(jnp.abs(force(rest.positions)).max())
    np.testing.assert_allclose(np.ravel(carried)[free], 0, atol=1e-8 * scale)

    def moved(k, h):
        flat = rest.positions.ravel().at[k].add(h)
        return np.ravel(force(flat.reshape(rest.positions.shape)))[free]

    h = 1e-5
    columns = [(8 * (moved(k, -h) - moved(k, h)) - (moved(k, -2 * h) - moved(k, 2 * h))) / (12 * h) for k in free]
    root = 1 / np.sqrt(np.repeat(np.asarray(nodal_mass(model, params.density)), 3)[free])
    squares = np.linalg.eigvalsh(root[:, None] * np.stack(columns, 1) * root)
    found, shapes = jf.modes(model, params, rest, 3, mass="lumped")
    np.testing.assert_allclose(found, np.sqrt(squares[:3]), rtol=1e-6)
    assert np.isfinite(np.asarray(shapes)).all()


SETS = [*zip(list(LAWS)[:3]), tuple(LAWS)[3:]]
SHARES = jnp.array([0.8, 1.0, 1.3])


def ends_of(names):
    """Where bars of several laws side by side are after three steps, with their first constants at one of SHARES."""
    first = {next(iter(LAWS[name].values)) for name in names}
    model, params, state = bars(names, tolerance=1e-12)

    def run(share):
        own = params.replace(**{name: share * getattr(params, name) for name in first})
        return jf.rollout(model, own, state, 2e-2, 3)[0].positions[-1]

    return run, np.asarray(model.node_body)


@pytest.mark.slow
@pytest.mark.parametrize("names", SETS, ids=" and ".join)
def test_each_lane_is_its_own_run(names):
    run, bodies = ends_of(names)
    alone = jnp.stack([run(share) for share in SHARES])
    apart = np.abs(alone[0] - alone[2]).max(axis=1)
    assert all(apart[bodies == k].max() > 1e-4 for k in range(len(names)))
    np.testing.assert_allclose(jax.vmap(run)(SHARES), alone, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("names", SETS, ids=" and ".join)
def test_single_precision_keeps_its_digits(names):
    states, info = jf.rollout(*bars(names, dtype="float32"), 2e-2, 3)
    assert states.positions.dtype == jnp.float32 and not info.status.any()
    np.testing.assert_allclose(states.positions[-1], ends_of(names)[0](SHARES[1]), atol=1e-5)


def test_the_edge_of_yield_is_counted_and_its_derivative_one_sided():
    """J2 at the edge itself: within, at, beyond; the tangent is that of one of the two sides."""
    law = LAWS["j2_plastic"]
    values, mu = values_of(law), 2e5 / 2.6
    edge = np.sqrt(2 / 3) * 1e3 / (2 * mu)
    strain = jnp.zeros((6, 3)).at[3].set(edge * jnp.array([0.9, 1.0, 1.1]))
    before = law.internal0(strain)
    after = law.commit(values, before, strain, 1.0, slice(0, 6))
    counts = law.counts(values, before, after, strain, 1.0, slice(0, 6))
    assert int(counts["at_yield"]) == 1 and 1 <= int(counts["flowing"]) <= 2

    def stress(size):
        one = jnp.zeros((5, 1)).at[2, 0].set(size)
        return jax.grad(lambda e: jnp.sum(law.sheared(values, e, law.internal0(e), None)))(one)[2, 0]

    slope, h = float(jax.jit(jax.grad(stress))(edge)), 1e-3 * edge
    sides = [float(stress(edge + side * h) - stress(edge)) / (side * h) for side in (-1, 1)]
    assert sides[1] < 0.7 * sides[0]
    assert min(abs(slope / side - 1) for side in sides) < 1e-6


@pytest.mark.parametrize("name", [pytest.param("j2_plastic", marks=pytest.mark.slow), "creep_plastic"])
def test_steps_tell_what_stands_at_the_edge_of_yield(name):
    """A bar held in a shape beyond yield flows back to the surface in a step, and stands there in the next."""
    body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), 1), material=LAWS[name], density=1e3, fixed="all")
    model, params, state = jf.build(jf.Scene([body], gravity=(0, 0, 0)))
    sheared = state.replace(positions=state.positions.at[:, 0].add(0.05 * state.positions[:, 2]))
    told = []
    for start in (state, sheared):
        for _ in range(2):
            start, info = jf.step(model, params, start, 0.1)  # creep over it is more than all of the strain
            told.append((int(info.counts["flowing"]), int(info.counts["at_yield"])))
    count = model.domains[0].count
    assert told == [(0, 0), (0, 0), (count, 0), (0, count)]


@pytest.mark.parametrize("name", ["neo_hookean", "mooney_rivlin", "j2_plastic"])
def test_equal_stretches_have_stress_and_tangent(name):
    """Turned rigidly, swollen evenly, two stretches equal: no stress at rest, and tangents are slopes of stresses."""
    law = LAWS[name]
    values = values_of(law)
    turn, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    shapes = [np.eye(3), turn, 1.001 * turn, turn @ np.diag([1.002, 1.002, 1.0]), turn @ np.diag([0.999, 1.001, 1.001])]
    gradients = jnp.asarray(np.stack(shapes, -1) - np.eye(3)[:, :, None])
    memory = law.internal0(jnp.zeros((6, len(shapes))))

    def energy(h):
        return law.density(values, law.stiffness(values)[0] / 3, h, memory, None)

    slope, tangent = jax.jit(lambda h: (slope_of(energy, h), tangent_of(energy, h)))(gradients)
    slope_alone, size = jax.jit(lambda h: slope_of(energy, h)), float(jnp.abs(tangent).max())
    np.testing.assert_allclose(slope[..., :2], 0, atol=1e-12 * size)
    for k in range(9):
        step = jnp.zeros(9).at[k].set(1e-5).reshape(3, 3, 1)
        along = (slope_alone(gradients + step) - slope_alone(gradients - step)) / 2e-5
        np.testing.assert_allclose(along.reshape(9, -1), tangent[:, k], atol=1e-6 * size)


def test_statics_and_modes_refuse_by_name_what_they_cannot_tell():
    """Where a body that flows rests depends on the way; a body with a memory has no frequencies of its own."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), 1)
    bodies = [
        jf.SoftBody(mesh.translated((0, 0.1 * k, 0)), material=law, density=1e3, fixed="x-", name=name)
        for k, (name, law) in enumerate([("plain", jf.Linear(**FIRM)), *LAWS.items()])
    ]
    scene = jf.build(jf.Scene([bodies[0], *bodies[3:]]))
    flowing = r'"j2_plastic" \(J2Plastic\), "creep_plastic" \(CreepPlastic\) comes to rest'
    with pytest.raises(jf.StepError, match=flowing):
        jf.equilibrium(*scene)
    with pytest.raises(jf.StepError, match=r'Plastic\), "viscoelastic" \(Viscoelastic\) has: .*storage_and_loss'):
        jf.modes(*scene)
