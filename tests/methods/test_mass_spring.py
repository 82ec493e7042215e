"""Springs in place of elements: what they are, when they are stable, and what they can never be."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from derivatives import check

import jaxfem as jf
from jaxfem.methods.mass_spring import MassSpring, highest_square, stretched
from jaxfem.solvers import describe

DT = 2e-3


def built(method, poisson=0.25, dtype=None, **more):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    values = dict(young=6e4, density=1070.0, damping=2e-3, mass_damping=1.0) | more
    body = jf.SoftBody(mesh, poisson=poisson, fixed="x-", **values)
    return jf.build(jf.Scene([body]), solver=method, dtype=dtype, tolerance=1e-12 if dtype is None else None)


def test_stiffness_averaged_over_directions_is_that_of_the_asked_modulus():
    """sum k L^2 n n n n / V has C_iijj = 6 E for a Cauchy solid of Young's modulus E."""
    model, params, _ = built("mass_spring")
    springs = stretched(model, params, model.rest, "volume")
    total = jnp.sum(springs.stiffness * springs.rest**2) / model.elements.volumes.sum()
    np.testing.assert_allclose(total, 6 * params.young, rtol=1e-12)


def test_their_stiffness_averaged_over_directions_has_poissons_ratio_a_quarter():
    """Invariants C_iijj and C_ijij of the stiffness of an even strain: 9 lam + 6 mu and 3 lam + 12 mu of its mean."""
    model, params, _ = built("mass_spring")
    springs = stretched(model, params, model.rest, "volume")
    weight = springs.stiffness * springs.rest**2 / model.elements.volumes.sum()
    tensor = jnp.einsum("s,si,sj,sk,sl->ijkl", weight, *[springs.along] * 4)
    bulk, shear = (float(jnp.einsum(each, tensor)) for each in ("iijj->", "ijij->"))
    lam, mu = np.linalg.solve([[9, 6], [3, 12]], [bulk, shear])
    np.testing.assert_allclose(lam / (2 * (lam + mu)), 0.25, rtol=1e-12)


def test_pulled_springs_grow_thin_alike_whatever_is_asked():
    """A bar of irregular elements under tension: about a quarter (0.19 to 0.21), for 0.05 as for 0.45."""
    rng = np.random.default_rng(0)
    axes = [np.linspace(0, length, count) for length, count in ((0.1, 11), (0.03, 4), (0.03, 4))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    inside = (grid > 1e-9) & (grid < np.array([0.1, 0.03, 0.03]) - 1e-9)
    mesh = jf.mesh.delaunay(grid + inside * rng.uniform(-3e-3, 3e-3, grid.shape))
    ends = np.stack([mesh.points[:, 0] > 0.1 - 1e-9, mesh.points[:, 0] < 1e-9])
    share = ends / ends.sum(1, keepdims=True)
    force = np.outer(1e-3 * (share[0] - share[1]), (1.0, 0, 0))
    ratios = []
    for asked in (0.05, 0.45):
        body = jf.SoftBody(mesh, young=6e4, poisson=asked, density=1e3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made = jf.build(jf.Scene([body], gravity=(0, 0, 0)), solver="mass_spring")
        state, info = jf.step(*made, dt=10.0, forces=force)  # so long a step is statics
        assert int(info.status) == 0
        rest = np.asarray(made[0].rest)
        middle = np.abs(rest[:, 0] - 0.05) < 0.03
        basis = np.column_stack([rest[middle], np.ones(middle.sum())])
        strain = np.linalg.lstsq(basis, (np.asarray(state.positions) - rest)[middle])[0][:3]
        ratios.append(-0.5 * (strain[1, 1] + strain[2, 2]) / strain[0, 0])
    assert ratios[0] == ratios[1]
    np.testing.assert_allclose(ratios[0], 0.25, atol=0.08)


def test_it_says_so_where_another_is_asked_for():
    with pytest.warns(jf.AccuracyWarning, match="Poisson's ratio 1/4"):
        built("mass_spring", poisson=0.4)


def test_explicit_and_implicit_steps_agree_as_steps_shrink():
    """Both are of first order: at half the step they are half as far apart."""
    gap = []
    for steps in (40, 80):
        pair = [built(MassSpring(each)) for each in ("implicit", "explicit")]
        ends = [scenes.rolled(*scene, 0.02 / steps, steps, chunk=40)[0] for scene in pair]
        gap.append(float(np.abs(ends[0].positions[-1] - ends[1].positions[-1]).max()))
    assert gap[1] < 0.6 * gap[0] and gap[1] < 1e-4


def test_a_step_above_the_explicit_limit_has_a_status_that_says_so():
    model, params, state = built(MassSpring("explicit"), damping=0.0)
    limit = 2 / float(jnp.sqrt(highest_square(model, params, "volume")))
    below, info = jf.rollout(model, params, state, 0.97 * limit, 40)
    assert not info.status.any() and jnp.abs(below.positions).max() < 0.2
    above, info = jf.rollout(model, params, state, 1.1 * limit, 40)
    assert info.status.all() and "stability limit of explicit springs" in describe(info.status[0])
    assert not jnp.abs(above.positions).max() < 0.2


@pytest.mark.parametrize("name", ["young", "density"])
def test_the_limit_is_that_of_the_values_now_whatever_was_prepared(name):
    model, params, state = built(MassSpring("explicit"), damping=0.0)
    limit = 2 / float(jnp.sqrt(highest_square(model, params, "volume")))
    model = jf.prepare(model, params, state, limit)
    share = 1.5 if name == "young" else 1 / 1.5
    other = params.replace(**{name: share * getattr(params, name)})
    for dt, status in ((0.97 * limit / 1.5**0.5, 0), (0.97 * limit, "stability limit of explicit springs")):
        told = jf.rollout(model, other, state, dt, 40)[1].status
        assert not told.any() if status == 0 else told.all() and status in describe(told[0])


def test_single_precision():
    single, info = jf.rollout(*built("mass_spring", dtype=jnp.float32), DT, 10)
    double, _ = jf.rollout(*built("mass_spring"), DT, 10)
    assert single.positions.dtype == jnp.float32 and not info.status.any()
    np.testing.assert_allclose(single.positions, double.positions, atol=1e-6)


@pytest.mark.parametrize("method", [MassSpring("implicit"), MassSpring("explicit", "lloyd")])
def test_derivatives_and_lanes(method):
    model, params, state = built(method)
    state = jf.rollout(model, params, state, 2e-4, 10)[0]
    state = jax.tree.map(lambda leaf: leaf[-1], state)  # no spring at its rest length, where derivatives are one-sided

    def tip(young, density, damping, alpha):
        values = dict(young=young * 6e4, density=density * 1070, damping=damping, mass_damping=alpha)
        return 10 * jf.rollout(model, params.replace(**values), state, 2e-4, 10)[0].velocities[-1, -1, 2]

    values = (1.0, 1.0, 2e-3, 1.0)
    check(tip, values)
    lanes = [each * np.array(values) for each in (0.8, 1.3)]
    both = jax.jit(jax.vmap(tip))(*np.stack(lanes, 1))
    np.testing.assert_allclose(both, [tip(*each) for each in lanes], rtol=1e-12)


@pytest.mark.parametrize(
    "settings, words", [(dict(integration="rk4"), "integration"), (dict(calibration="x"), "volume")]
)
def test_settings_that_are_not_known_are_refused(settings, words):
    with pytest.raises(jf.SceneError, match=f'"mass_spring" has .*{words}'):
        built(MassSpring(**settings))


@pytest.mark.slow
def test_springs_do_not_converge_where_finite_elements_do():
    """A cube held all around under a smooth force, with nu = 1/4, the springs' own: orders 0.1 and 2."""
    off = {}
    for method in ("mass_spring", "assembled"):
        for cells in (4, 8):
            mesh = jf.mesh.box((1.0, 1.0, 1.0), cells)
            held = (np.abs(mesh.points - 0.5) > 0.5 - 1e-9).any(1)
            body = jf.SoftBody(mesh, young=1e5, poisson=0.25, density=1.0, fixed=held)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model, params, state = jf.build(jf.Scene([body], gravity=(0, 0, 0)), solver=method)
            # u = s a with s = sin sin sin, a = (1, 0, 0): -div sigma = (lam + mu) pi^2 (s, -c c s, ...) + 3 pi^2 mu u
            s, c = np.sin(np.pi * mesh.points).T, np.cos(np.pi * mesh.points).T
            bump = s[0] * s[1] * s[2]
            mixed = np.stack([bump, -c[0] * c[1] * s[2], -c[0] * s[1] * c[2]], 1)
            force = np.pi**2 * (0.8 * mixed + 3 * 0.4 * bump[:, None] * np.array([1.0, 0, 0]))
            small = 0.1 * force * np.asarray(model.nodal_volumes)[:, None]
            end, info = jf.step(model, params, state, dt=1e3, forces=small)
            assert int(info.status) == 0
            way = np.asarray(end.positions) - mesh.points - 1e-6 * np.outer(bump, [1.0, 0, 0])
            off[method, cells] = np.linalg.norm(way) / np.linalg.norm(1e-6 * bump)
    assert off["assembled", 8] < off["assembled", 4] / 3.5
    assert off["mass_spring", 8] > off["mass_spring", 4] / 1.3 > 0.1
