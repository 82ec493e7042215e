"""Equilibrium against outside solutions, by Newton's method and by stepping until rest, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from derivatives import Parted

import jaxfem as jf
from jaxfem.io import FrameWriter, read_frames


def reference_scene(values, gravity, young=1e6, poisson=0.3, **build):
    mesh = jf.TetMesh(values["nodes"], values["tets"])
    fixed = values["nodes"][:, 0] < 1e-9
    body = jf.SoftBody(mesh, young=young, poisson=poisson, density=1000.0, damping=0.05, fixed=fixed)
    return jf.build(jf.Scene([body], gravity=gravity), **build)


def test_small_loads_give_linear_elasticity(reference):
    """At 1e-6 g every component to 1e-6; at 1e-3 g what is left of u_z (6e-5) is the corotated model's own bending."""
    values = np.load(reference / "static_linear_8x2x2.npz")
    for poisson in (0.0, 0.3, 0.45):
        linear = values[f"u_nu{poisson}"]
        error = {}
        for factor in (1e-3, 5e-4, 1e-6):
            model, params, state = reference_scene(values, (0, 0, -9.81 * factor), poisson=poisson)
            rest, info = jf.equilibrium(model, params, state)
            assert info.status == 0
            found = np.asarray(rest.positions - model.rest) * (1e-3 / factor)
            error[factor] = np.abs(found - linear).max(0) / np.abs(linear).max()
        assert error[1e-6].max() < 1e-6
        assert error[1e-3][2] < 7e-5
        # Half the load, half the difference: it is the model's, not the solver's.
        np.testing.assert_allclose(error[5e-4], error[1e-3] / 2, rtol=0.01)


@pytest.mark.parametrize(
    "name",
    [
        "corotated_equilibrium_8x2x2",
        pytest.param("corotated_equilibrium_16x4x4_soft_load", marks=pytest.mark.slow),
    ],
)
def test_equilibrium_equals_the_outside_solution(reference, name):
    values = np.load(reference / f"{name}.npz")
    model, params, state = reference_scene(values, values["g"], tolerance=1e-10)
    rest, info = jf.equilibrium(model, params, state)
    assert info.status == 0
    error = np.abs(rest.positions - values["nodes"] - values["u"]).max()
    assert error < 1e-7 * np.abs(values["u"]).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["corotated_equilibrium_8x2x2", "corotated_equilibrium_16x4x4_soft_load"])
def test_stepping_with_damping_comes_to_rest_there_too(reference, name):
    values = np.load(reference / f"{name}.npz")
    model, params, state = reference_scene(values, values["g"], tolerance=1e-8)
    states, info = jf.rollout(model, params, state, 0.2, 400, every=400)
    assert (info.status == 0).all()
    error = np.abs(states.positions[-1] - values["nodes"] - values["u"]).max()
    assert error < 1e-7 * np.abs(values["u"]).max()


@pytest.mark.slow
def test_equilibrium_in_float32():
    sag = {}
    for dtype in (jnp.float32, jnp.float64):
        model, params, state = scenes.beam(build={"dtype": dtype})
        rest, info = jf.equilibrium(model, params, state)
        assert info.status == 0
        sag[dtype] = rest.positions - model.rest
    assert sag[jnp.float32].dtype == jnp.float32
    largest = float(jnp.abs(sag[jnp.float64]).max())
    np.testing.assert_allclose(sag[jnp.float32], sag[jnp.float64], atol=1e-3 * largest)


@pytest.mark.slow
def test_single_precision_feels_small_loads_near_incompressibility():
    """Rounding alone makes forces as large as these loads; what is lost in it is a status, not a number."""
    sags = {}
    for dtype in (jnp.float32, jnp.float64):
        model, params, state = scenes.beam((6, 2, 2), poisson=0.499, strain="smoothed", build={"dtype": dtype})
        tip = np.asarray(model.rest[:, 0]) > 0.0999
        for pull in (9.81, 1.0, 1e-3, 1e-9, 0.0):
            own = params.replace(gravity=jnp.array([0, 0, -pull], dtype))
            rest, info = jf.equilibrium(model, own, state)
            sags[dtype, pull] = np.asarray(state.positions - rest.positions)[tip, 2].mean(), int(info.status)
    for pull in (9.81, 1.0, 1e-3):
        (single, status), (double, _) = sags[jnp.float32, pull], sags[jnp.float64, pull]
        assert status == 0
        np.testing.assert_allclose(single, double, rtol=1e-2)
    assert sags[jnp.float32, 1e-9][1] != 0
    assert sags[jnp.float32, 0.0][1] == 0 and abs(sags[jnp.float32, 0.0][0]) < 1e-7


def test_a_body_that_nothing_holds_has_no_equilibrium():
    model, params, state = scenes.beam((2, 1, 1), fixed=None)
    _, info = jf.equilibrium(model, params, state)
    assert info.status != 0


def test_gram_schmidt_is_refused():
    model, params, state = scenes.beam((2, 1, 1), rotation="gram_schmidt")
    with pytest.raises(jf.StepError, match="has no energy to minimise"):
        jf.equilibrium(model, params, state)


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_derivatives_of_equilibrium(strain):
    """jvp = vjp = differences in E, nu, density, gravity, loads (a follower pressure too) and held nodes' positions."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    loads = [jf.Traction("x+", (0.0, 30.0, -50.0)), jf.Pressure("z+", 80.0)]
    body = jf.SoftBody(mesh, young=2.6e5, poisson=0.4, density=1070.0, fixed="x-", loads=loads, strain=strain)
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-12)
    values = {k: getattr(params, k) for k in ("young", "poisson", "density", "gravity", "loads")}
    rng = np.random.default_rng(4)
    scale = jax.tree.map(lambda v: jnp.asarray(rng.standard_normal(v.shape)) * jnp.abs(v).max(), values)
    held = jnp.asarray(1e-3 * rng.standard_normal(state.positions.shape)) * (1 - model.free[:, None])
    point, direction = (values, state.positions), (scale, held)

    @Parted
    def loss(h):
        own, positions = jax.tree.map(lambda p, d: p + h * d, point, direction)
        rest, _ = jf.equilibrium(model, params.replace(**own), state.replace(positions=positions))
        return 1e3 * jnp.sum(rest.positions[:, 2] * jnp.arange(model.nodes))

    forward, (backward,), h = loss.forwards(0.0, direction=(1.0,)), loss.backwards(0.0), 1e-4
    differences = [(loss(s) - loss(-s)) / (2 * s) for s in (h / 2, h)]
    np.testing.assert_allclose(forward, backward, rtol=1e-8)
    np.testing.assert_allclose(forward, (4 * differences[0] - differences[1]) / 3, rtol=1e-6)


def test_derivative_without_pressure_uses_the_symmetric_solve():
    model, params, state = scenes.beam((2, 1, 1), build={"tolerance": 1e-12})

    @jax.jit
    @jax.value_and_grad
    def loss(young):
        rest, _ = jf.equilibrium(model, params.replace(young=young), state)
        return 1e3 * jnp.sum(rest.positions[:, 2])

    h = 20.0
    central = (loss(params.young + h)[0] - loss(params.young - h)[0]) / (2 * h)
    np.testing.assert_allclose(loss(params.young)[1], central, rtol=1e-6)


@pytest.mark.slow
def test_lanes_equal_single_solves():
    model, params, state = scenes.beam((2, 1, 1), build={"tolerance": 1e-10})
    young = jnp.array([5e4, 2e5, 1e6])

    def rest(value):
        return jf.equilibrium(model, params.replace(young=value), state)[0].positions

    together = jax.vmap(rest)(young)
    for lane in range(3):
        np.testing.assert_allclose(together[lane], rest(young[lane]), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_armadillo_sags_and_comes_to_rest(data, dtype, tmp_path):
    """A scanned figure, 0.3 m tall, feet fixed: by statics, by stepping with heavy damping, and read back from VTU."""
    mesh = jf.mesh.read(data / "meshes" / "armadillo_4k.node")
    height = np.ptp(mesh.points, axis=0)[1]
    mesh = mesh.scaled(0.3 / height)
    low = mesh.points[:, 1].min()
    body = jf.SoftBody(mesh, young=2e6, poisson=0.4, density=1000.0, damping=0.05, fixed=mesh.points[:, 1] < low + 0.01)
    model, params, state = jf.build(jf.Scene([body], gravity=(0, -9.81, 0)), dtype=dtype)
    rest, info = jf.equilibrium(model, params, state)
    assert info.status == 0
    sag = jnp.abs(rest.positions - model.rest).max()
    assert 0.002 < sag < 0.1
    states, infos = jf.rollout(model, params, state, 0.05, 200, every=200)
    assert (infos.status == 0).all()
    assert jnp.abs(states.velocities[-1]).max() < 1e-3
    assert jnp.abs(states.positions[-1] - rest.positions).max() < 0.02 * sag
    with FrameWriter(tmp_path, "armadillo", model, params) as writer:
        writer.write(rest)
    (frame,) = read_frames(writer.index)
    np.testing.assert_allclose(frame.positions, rest.positions, atol=1e-6)
    np.testing.assert_array_equal(frame.cells, model.elements.cells)
