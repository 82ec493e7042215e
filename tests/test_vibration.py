"""Natural frequencies and shapes: against outside values and a host eigensolver, and their derivatives."""

import host
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenes
from derivatives import Parted

import jaxfem as jf

OUTSIDE = scenes.outside("clamped_beams")["frequencies"]
CONVERGED = np.array(OUTSIDE["converged"])
PLAIN = {kind: OUTSIDE[kind] for kind in ("lumped", "consistent")}  # linear tetrahedra of an outside library


def long_box(strain, cells=(16, 4, 4), tets=6, mirrored=True):
    mesh = jf.mesh.box((4.0, 1.0, 1.0), cells, tets_per_cell=tets, mirrored=mirrored)
    body = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, fixed="x-", strain=strain)
    return jf.build(jf.Scene([body]))


def test_plain_frequencies_are_those_of_another_library():
    model, params, _ = long_box("element")
    for kind, values in PLAIN.items():
        np.testing.assert_allclose(host.frequencies(model, params, kind)[0], values, atol=6e-5)


@pytest.mark.parametrize(
    ("tets", "mirrored", "lumped", "averaged"),
    [(6, True, 0.05, 0.02), (12, False, 0.015, 0.01), (12, True, 0.01, 0.012)],
)
def test_smoothed_frequencies_are_near_the_converged_ones(tets, mirrored, lumped, averaged):
    model, params, _ = long_box("smoothed", tets=tets, mirrored=mirrored)
    for kind, limit in (("lumped", lumped), ("averaged", averaged)):
        assert np.abs(host.frequencies(model, params, kind)[0] / CONVERGED - 1).max() < limit


def uneven(strain="smoothed", dtype=None, cells=(4, 2, 2), **kwargs):
    """A beam whose stiffness and density differ from element to element."""
    model, params, state = scenes.beam(cells, strain=strain, build={"dtype": dtype}, **kwargs)
    rng = np.random.default_rng(5)
    spread = jnp.asarray(rng.uniform(0.5, 1.5, (2, model.elements.count)), model.rest.dtype)
    return model, params.replace(young=params.young * spread[0], density=params.density * spread[1]), state


def test_modes_equal_the_host_solver():
    model, params, state = uneven()
    mass = "averaged"
    frequencies, shapes = jf.modes(model, params, state, 6, mass)
    expected, vectors = host.frequencies(model, params, mass)
    np.testing.assert_allclose(frequencies, expected, rtol=1e-9)
    weights = host.mass(model, params, mass)
    flat = np.asarray(shapes).reshape(6, -1)
    np.testing.assert_allclose(flat @ weights @ flat.T, np.eye(6), atol=1e-9)
    np.testing.assert_allclose(np.abs(flat @ weights @ vectors.reshape(6, -1).T), np.eye(6), atol=1e-6)
    assert (np.take_along_axis(flat, np.abs(flat).argmax(1)[:, None], 1) > 0).all()
    assert (np.asarray(shapes)[:, np.asarray(model.free) == 0] == 0).all()


@pytest.mark.slow
def test_a_free_body_has_six_rigid_motions_and_float32_agrees():
    found = {}
    for dtype in (jnp.float32, jnp.float64):
        model, params, state = uneven("element", dtype, fixed=None)
        found[dtype], shapes = jf.modes(model, params, state, 10)
        assert shapes.dtype == dtype
        assert (found[dtype][:6] == 0).all()
    np.testing.assert_allclose(found[jnp.float32][6:], found[jnp.float64][6:], rtol=3e-4)
    expected = host.frequencies(model, params, count=10, shift=-1.0)[0]
    np.testing.assert_allclose(found[jnp.float64][6:], expected[6:], rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_derivatives(strain):
    """jvp = vjp = differences of frequencies and shapes, in E and density an element, nu and the shape (prestress)."""
    model, params, state = uneven(strain, cells=(3, 1, 1))
    model = model.replace(tolerance=jnp.asarray(1e-10))
    rng = np.random.default_rng(8)
    values = {k: getattr(params, k) for k in ("young", "poisson", "density")}
    point = (values, state.positions + 1e-3 * rng.standard_normal(state.positions.shape))
    direction = jax.tree.map(lambda v: jnp.asarray(rng.standard_normal(v.shape)) * 0.1 * jnp.abs(v).max(), point)
    weights = jnp.asarray(rng.standard_normal((4, *state.positions.shape)))

    @Parted
    def outputs(h):
        own, positions = jax.tree.map(lambda p, d: p + h * d, point, direction)
        frequencies, shapes = jf.modes(model, params.replace(**own), state.replace(positions=positions), 4, "averaged")
        return jnp.concatenate([frequencies, jnp.einsum("iak,iak->i", weights, shapes)])

    forward, h = outputs.forwards(0.0, direction=(1.0,)), 1e-4
    backward = [outputs.backwards(0.0, weight=weight)[0] for weight in jnp.eye(8)]
    differences = [(outputs(s) - outputs(-s)) / (2 * s) for s in (h / 2, h)]
    np.testing.assert_allclose(forward, backward, rtol=1e-7)
    np.testing.assert_allclose(forward, (4 * differences[0] - differences[1]) / 3, rtol=1e-5)


def symmetric_cube():
    """24 tetrahedra on the edges of a cube, its faces' middles and its own: it has every symmetry of a cube."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    points, cells = [*corners, np.full(3, 0.5)], []
    for axis in range(3):
        for side in (0, 1):
            face = np.flatnonzero(corners[:, axis] == side)
            edges = [(a, b) for a in face for b in face if a < b and np.abs(corners[a] - corners[b]).sum() == 1]
            cells += [(8, len(points), a, b) for a, b in edges]
            points.append(corners[face].mean(0))
    cells = np.array(cells)
    x = np.array(points)[cells]
    flipped = np.linalg.det(x[:, 1:] - x[:, :1]) < 0
    cells[flipped] = cells[flipped][:, [0, 1, 3, 2]]
    return jf.TetMesh(0.03 * np.array(points), cells)


@pytest.mark.slow
def test_repeated_frequencies_have_finite_derivatives():
    """A cube that looks the same along y and z bends alike both ways; also lanes of vmap against single calls."""
    mesh = symmetric_cube()
    nodes = mesh.points[:, 0] == 0
    model, params, state = jf.build(jf.Scene([jf.SoftBody(mesh, 2e5, 0.4, 1000.0, fixed=nodes)]))

    def outputs(young):
        return jf.modes(model, params.replace(young=young), state, 3)

    (frequencies, shapes), (slopes, turning) = jax.jit(lambda e: jax.jvp(outputs, (e,), (jnp.ones(()),)))(params.young)
    np.testing.assert_allclose(frequencies[0], frequencies[1], rtol=1e-9)
    np.testing.assert_allclose(slopes, frequencies / (2 * params.young), rtol=1e-7)
    # Shapes do not change with a uniform E.
    assert jnp.isfinite(turning).all() and jnp.abs(turning).max() * params.young < 1e-4 * jnp.abs(shapes).max()
    young = jnp.array([1e5, 2e5, 4e5])
    lanes = jax.vmap(lambda e: outputs(e)[0])(young)
    np.testing.assert_allclose(lanes, frequencies * jnp.sqrt(young / params.young)[:, None], rtol=1e-9)


def test_what_does_not_converge_is_nan_and_mistakes_are_named():
    model, params, state = scenes.beam((1, 1, 1))
    frequencies, _ = jf.modes(model, params, state, 14)
    assert jnp.isfinite(frequencies[:12]).all() and jnp.isnan(frequencies[12:]).all()
    squeezed = state.replace(positions=state.positions * jnp.array([0.4, 1.0, 1.0]))
    assert jnp.isnan(jf.modes(model, params, squeezed, 14)[0][0])
    for arguments, words in (((0,), "count is 0"), ((6, "heavy"), "known: lumped")):
        with pytest.raises(jf.StepError, match=words):
            jf.modes(model, params, state, *arguments)
