"""Laws of rubber: their energies against formulas, their tangents, steps on all kinds of strain, statics and modes."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.materials.moduli import eigenstiffness
from jaxfem.materials.principal import definite_part, slope_of, tangent_of
from jaxfem.methods.nodes.condensed import condensed_matrix, linearised
from jaxfem.system.soft import momentum_gradient, step_system

POISSON = 0.4
LAWS = {
    "neo_hookean": jf.NeoHookean(young=6e4, poisson=POISSON),
    "mooney_rivlin": jf.MooneyRivlin(c10=8e3, c01=4e3, poisson=POISSON),
    "yeoh": jf.Yeoh(c1=1e4, c2=5e2, c3=30.0, poisson=POISSON),
}
SHEAR = {"neo_hookean": 6e4 / 2.8, "mooney_rivlin": 2.4e4, "yeoh": 2e4}
GRADIENTS = np.random.default_rng(0).normal(size=(3, 3, 40)) * 0.4


def density(law, whole=True):
    """Energy density of H (3, 3, D) with or without the change of volume."""
    values = {name: jnp.asarray(value, float) for name, value in law.values.items()}
    bulk = law.stiffness(values)[0] / 3 if whole else None
    return lambda h: law.density(values, bulk, h, None, None)


@pytest.mark.parametrize("name", LAWS)
def test_small_strains_see_the_linear_law(name):
    """The tangent at rest is 3K on the volumetric part and 2 mu on the deviatoric one, which alone has no bulk."""
    shear = SHEAR[name]
    volumetric, deviatoric = eigenstiffness(2 * shear * (1 + POISSON), POISSON)
    unit = np.eye(9)
    symmetric = 0.5 * (unit + unit.reshape(3, 3, 9).swapaxes(0, 1).reshape(9, 9))
    mean = np.outer(np.eye(3), np.eye(3)) / 3
    for whole in (True, False):
        found = tangent_of(density(LAWS[name], whole), jnp.zeros((3, 3, 1)))[..., 0]
        wanted = deviatoric * (symmetric - mean) + (volumetric if whole else 0) * mean
        np.testing.assert_allclose(found, wanted, atol=1e-9 * volumetric)


def by_formula(name, f):
    """First Piola-Kirchhoff stress by the textbook, from F (3, 3)."""
    shear = SHEAR[name]
    jump, turned = np.linalg.det(f), np.linalg.det(f) * np.linalg.inv(f).T  # J and cof F
    bulk = 2 * shear * (1 + POISSON) / (3 * (1 - 2 * POISSON))
    squares = np.sum(f * f)
    if name == "neo_hookean":  # Smith, de Goes & Kim 2018, equation 15
        m, lam = 4 / 3 * shear, bulk - 2 / 3 * shear + 5 / 6 * shear
        return m * (1 - 1 / (squares + 1)) * f + lam * (jump - 1 - 0.75 * m / lam) * turned
    first = jump ** (-2 / 3) * (2 * f - 2 / 3 * squares * turned / jump)
    pressure = bulk * (jump - 1) * turned
    if name == "yeoh":
        x = squares * jump ** (-2 / 3) - 3
        return (1e4 + 1e3 * x + 90 * x**2) * first + pressure
    c = f.T @ f
    second = jump ** (-4 / 3) * (2 * squares * f - 2 * f @ c)
    second -= 4 / 3 * 0.5 * (squares**2 - np.sum(c * c)) * jump ** (-4 / 3) * turned / jump
    return 8e3 * first + 4e3 * second + pressure


@pytest.mark.parametrize("name", LAWS)
def test_stress_is_that_of_the_textbook(name):
    deformations = np.moveaxis(GRADIENTS, -1, 0) + np.eye(3)
    good = np.linalg.det(deformations) > (-9 if name == "neo_hookean" else 0.26)
    assert 20 < good.sum()
    found = np.moveaxis(np.asarray(slope_of(density(LAWS[name]), jnp.asarray(GRADIENTS))), -1, 0)
    for stress, f in zip(found[good], deformations[good], strict=True):
        np.testing.assert_allclose(stress, by_formula(name, f), rtol=1e-10, atol=1e-8 * np.abs(stress).max())


@pytest.mark.parametrize("name", LAWS)
def test_definite_tangents_lose_their_negative_eigenvalues_and_nothing_else(name):
    gradients = np.concatenate([GRADIENTS, np.zeros((3, 3, 1)), -2 * np.eye(3)[:, :, None]], axis=-1)
    exact = jax.jit(partial(tangent_of, density(LAWS[name])))(gradients)
    found = np.moveaxis(np.asarray(jax.jit(definite_part)(exact, gradients)), -1, 0)
    exact = np.moveaxis(np.asarray(exact), -1, 0)
    values, vectors = np.linalg.eigh(exact)
    assert 5 < (values.min(1) < -1.0).sum() < len(values)
    wanted = np.einsum("dij,dj,dkj->dik", vectors, np.maximum(values, 0), vectors)
    np.testing.assert_allclose(found, wanted, atol=1e-9 * np.abs(wanted).max())


def test_energies_stay_finite_where_elements_are_flat_or_inside_out():
    """And push back: the energy of an element pressed through itself rises all the way."""
    heights = np.linspace(1.0, -1.0, 81)
    gradients = np.zeros((3, 3, 81))
    gradients[2, 2] = heights - 1
    for name, law in LAWS.items():
        energy = np.asarray(density(law)(jnp.asarray(gradients)))
        assert np.isfinite(energy).all() and (np.diff(energy) > 0).all(), name


@jax.jit
def pulled(c, stretches):
    """Engineering stress of a nearly incompressible Yeoh solid pulled to `stretches`, its sides free."""
    values = {"c1": c[0], "c2": c[1], "c3": c[2], "poisson": jnp.asarray(0.5 - 1e-9)}
    law = jf.Yeoh(c1=1.0, poisson=0.4).law
    bulk = law.stiffness(values)[0] / 3

    def stress(narrow):
        entries = jnp.stack([stretches - 1, narrow - 1, narrow - 1])
        slope = slope_of(lambda h: law.density(values, bulk, h, None, None), jnp.eye(3)[:, :, None] * entries[:, None])
        return slope[1, 1], slope[0, 0]

    def closer(_, narrow):
        side, rate = jax.jvp(lambda n: stress(n)[0], (narrow,), (jnp.ones_like(narrow),))
        return narrow - side / rate

    return stress(jax.lax.fori_loop(0, 8, closer, stretches**-0.5))[1]


def test_uniaxial_curves_of_silicones(reference):
    """The table's curves to 1e-6, and its measured stresses to what it says of the fit."""
    text = (reference / "silicones.md").read_text().splitlines()
    lines = [line for line in text if line.startswith("| ")][2:]
    assert len(lines) == 7
    stretches = jnp.array([1.5, 2.0, 3.0, 4.0])
    x = np.asarray(stretches**2 + 2 / stretches - 3)
    for line in lines:
        name, measured, constants, _, rms = [each.strip() for each in line.split("|")[1:-1]]
        c = 1e3 * np.array([float(each) for each in constants.replace(",", " ").split()])
        wanted = 2 * np.asarray(stretches - stretches**-2) * (c[0] + 2 * c[1] * x + 3 * c[2] * x**2)
        found = np.asarray(pulled(c, stretches))
        np.testing.assert_allclose(found, wanted, rtol=1e-6, err_msg=name)
        off = found / 1e3 - np.array([float(each) for each in measured.split()])
        assert np.abs(off).max() < 4 * float(rms), name


STRAINS = ("element", "nodal_volume", "smoothed")


def bar(law, strain="element", cells=(2, 1, 1), build=None, **body):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells)
    soft = jf.SoftBody(mesh, material=law, density=1e3, strain=strain, **{"fixed": "x-", **body})
    return jf.build(jf.Scene([soft]), **(build or {}))


@pytest.mark.parametrize("strain", STRAINS)
def test_the_matrix_of_a_round_is_the_slope_of_the_condition(strain):
    """Exact in the bulk as well, at a shape far from rest, on elements, edges, nodes and clusters."""
    law = jf.NeoHookean(young=6e4, poisson=0.45, damping=3e-3)
    model, params, state = bar(law, strain)
    rng = np.random.default_rng(1)
    state = state.replace(positions=state.positions * 1.3 + 4e-3 * rng.normal(size=state.positions.shape))
    free = np.asarray(model.free)[:, None]
    v, w = (jnp.asarray(free * rng.normal(size=state.positions.shape)) for _ in range(2))

    @jax.jit
    def both(v, w):
        system = step_system(model, params, state, jnp.asarray(1e-2))
        pattern = model.pattern
        product = pattern.scattered(condensed_matrix(linearised(system, v)).apply(pattern.gathered(w)))
        return product, jax.jvp(lambda v: momentum_gradient(system, v), (v,), (w,))[1]

    product, change = both(v, w)
    np.testing.assert_allclose(product, change, atol=1e-10 * float(jnp.abs(change).max()))


@pytest.mark.parametrize("name", LAWS)
def test_small_loads_bend_a_bar_as_the_linear_law_does(name):
    """Stiff bars under their weight: the linear law's steps but for the strain itself."""
    ends = {}
    for law in (jf.Linear(2 * SHEAR[name] * (1 + POISSON), POISSON, 2e-3), LAWS[name]):
        values = {**law.values, "damping": 2e-3}
        model, params, state = bar(type(law)(**values), "smoothed")
        params = params.replace(gravity=1e-3 * params.gravity)
        states, info = jf.rollout(model, params, state, 2e-3, 6)
        assert not info.status.any()
        ends[law] = np.asarray(states.positions[-1] - model.rest)
    linear, other = ends.values()
    np.testing.assert_allclose(other, linear, atol=1e-4 * np.abs(linear).max())


def test_what_cannot_be_served_is_refused_by_name():
    for options, words in (
        ({"solver": "mprgp"}, 'solver "mprgp" takes laws that are linear in a step, which NeoHookean is not'),
        ({"rotation_update": "implicit"}, "is for linear laws; NeoHookean takes"),
    ):
        with pytest.raises(jf.SceneError, match=words):
            bar(LAWS["neo_hookean"], build=options)
    with pytest.raises(jf.MaterialError, match="c10 \\+ c01 must be > 0 Pa"):
        jf.MooneyRivlin(c10=1e3, c01=-1e3, poisson=0.4)


DERIVED = {
    "neo_hookean": jf.NeoHookean(young=6e3, poisson=0.4, damping=1e-2),
    "mooney_rivlin": jf.MooneyRivlin(c10=2e3, c01=1e3, poisson=0.4, damping=1e-2),
    "yeoh": jf.Yeoh(c1=3e3, c2=1e3, c3=1e3, poisson=0.4, damping=1e-2),
    "j2_plastic": jf.J2Plastic(
        young=2e5,
        poisson=0.3,
        damping=1e-2,
        yield_stress=1e3,
        isotropic_hardening=4e4,
        kinematic_hardening=3e4,
    ),
}


def end_of(scene, law, shares):
    """Where the last node is after some steps, with each of the law's constants times its share."""
    model, params, state = scene
    values = {name: share * value for share, (name, value) in zip(shares, law.values.items(), strict=True)}
    states, _ = jf.rollout(model, params.replace(**values), state, 2e-2, 3)
    return 1e2 * states.positions[-1, -1, 2]


@pytest.mark.slow
@pytest.mark.parametrize("name", DERIVED)
def test_derivatives_in_all_constants(name):
    """Reverse = differences to 1e-6, of a bar that bends far, or yields; forward too, with a memory and without."""
    law = DERIVED[name]
    scene = bar(law, cells=(1, 1, 1), build={"tolerance": 1e-13})
    steps = {"h": 1e-3 if name != "j2_plastic" else 1e-5, "forwards": name in ("neo_hookean", "j2_plastic")}
    check(lambda *shares: end_of(scene, law, shares), (1.0,) * len(law.values), **steps)


@pytest.mark.slow
def test_derivatives_where_an_element_is_inside_out():
    """All elements mirrored: no exception to the law, nor to its derivatives."""
    law = DERIVED["neo_hookean"]
    model, params, state = bar(law, cells=(1, 1, 1), build={"tolerance": 1e-13})
    free = np.asarray(model.free) > 0
    through = jnp.where(free[:, None], state.positions - jnp.array([0.12, 0.0, 0.0]), state.positions)
    scene = model, params, state.replace(positions=through)
    _, info = jf.step(*scene, 1e-3)
    assert int(info.inverted) > 0

    def end(*shares):
        values = {name: share * value for share, (name, value) in zip(shares, law.values.items(), strict=True)}
        return 1e2 * jf.step(*scene[:1], params.replace(**values), scene[2], 5e-3)[0].positions[-1, 0]

    check(end, (1.0, 1.0, 1.0), h=1e-4)


@pytest.mark.slow
def test_lanes_of_a_batch_and_single_precision():
    """Each lane of vmap is its own run, and float32 keeps its digits."""
    law = DERIVED["yeoh"]
    model, params, state = bar(law, cells=(1, 1, 1))
    shares = jnp.array([0.8, 1.0, 1.3])

    def run(share):
        return jf.rollout(model, params.replace(c1=share * params.c1), state, 2e-2, 3)[0].positions[-1]

    alone = jnp.stack([run(share) for share in shares])
    np.testing.assert_allclose(jax.vmap(run)(shares), alone, atol=1e-9)
    model, params, state = bar(law, cells=(1, 1, 1), build={"dtype": "float32"})
    states, info = jf.rollout(model, params, state, 2e-2, 3)
    assert states.positions.dtype == jnp.float32 and not info.status.any()
    np.testing.assert_allclose(states.positions[-1], alone[1], atol=1e-5)
