"""The assembled system of Mueller & Gross 2004 against paper A's rows, and what it refuses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf

DT = 4e-3


def scene(solver, mass_damping=1.5, rotation="polar", dtype=None):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1))
    values = dict(young=6e4, poisson=0.3, density=1070.0, damping=2e-3)
    body = jf.SoftBody(mesh, fixed="x-", rotation=rotation, mass_damping=mass_damping, **values)
    tolerance = 1e-13 if dtype is None else None
    return jf.build(jf.Scene([body]), solver=solver, dtype=dtype, tolerance=tolerance)


@pytest.mark.parametrize("rotation", ["polar", "gram_schmidt"])
def test_it_is_paper_a_step_for_step(rotation):
    """Rows from strains, and an assembled matrix of warped element stiffnesses: one system, two ways."""
    runs = [jf.rollout(*scene(solver, rotation=rotation), DT, 20)[0] for solver in ("assembled", "condensed")]
    size = float(jnp.abs(runs[1].positions - runs[1].positions[0]).max())
    assert size > 5e-3
    np.testing.assert_allclose(runs[0].positions, runs[1].positions, atol=1e-10 * 0.1, rtol=0)
    np.testing.assert_allclose(runs[0].velocities, runs[1].velocities, atol=1e-10, rtol=0)


def test_it_is_the_all_rows_method_too():
    runs = [jf.rollout(*scene(solver), DT, 5)[0] for solver in ("assembled", "mprgp")]
    np.testing.assert_allclose(runs[0].positions, runs[1].positions, atol=1e-10 * 0.1, rtol=0)


def test_single_precision():
    model, params, state = scene("assembled", dtype=jnp.float32)
    single, info = jf.rollout(model, params, state, DT, 20)
    double = jf.rollout(*scene("assembled"), DT, 20)[0]
    assert single.positions.dtype == jnp.float32 and not info.status.any()
    np.testing.assert_allclose(single.positions, double.positions, atol=2e-6)


def test_derivatives_and_lanes():
    model, params, state = scene("assembled")

    def tip(young, poisson, density, damping, alpha):
        values = dict(young=young * 6e4, poisson=poisson, density=density * 1070, damping=damping, mass_damping=alpha)
        end, _ = jf.rollout(model, params.replace(**values), state, DT, 4)
        return 1e3 * end.positions[-1, -1, 2]

    values = (1.0, 0.3, 1.0, 2e-3, 1.5)
    run = check(tip, values)
    lanes = [each * np.array(values) for each in (0.8, 1.3)]
    both = jax.jit(jax.vmap(tip))(*np.stack(lanes, 1))
    np.testing.assert_allclose(both, [run(*each) for each in lanes], rtol=1e-10)


@pytest.mark.parametrize(
    "body, build, words",
    [
        (dict(strain="smoothed"), {}, 'strain = "element" alone, not "smoothed"'),
        ({}, dict(mass="consistent"), 'mass = "lumped" alone'),
        ({}, dict(scheme="generalized_alpha"), 'scheme = "backward_euler" alone'),
        ({}, dict(rotation_update="implicit"), "explicit"),
        (dict(material=jf.NeoHookean(young=1e5, poisson=0.3)), {}, "NeoHookean"),
        (dict(material=jf.CreepPlastic(young=1e5, poisson=0.3, damping=0.0, yield_strain=0.1, creep=1.0)), {}, "Creep"),
    ],
)
@pytest.mark.parametrize("solver", ["assembled", "mass_spring", "groupwise"])
def test_what_it_cannot_do_is_refused_by_name(solver, body, build, words):
    material = {} if "material" in body else dict(young=1e5, poisson=0.3)
    made = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), density=1e3, **material, **body)
    with pytest.raises(jf.SceneError, match=f'"{solver}" .*{words}'):
        jf.build(jf.Scene([made]), solver=solver, **build)


def test_contacts_are_refused():
    made = jf.SoftBody(jf.mesh.box((0.1, 0.1, 0.1), 1), young=1e5, poisson=0.3, density=1e3)
    with pytest.raises(jf.SceneError, match='"assembled" is for soft bodies alone'):
        jf.build(jf.Scene([made], contacts=[jf.Contact(made, jf.Plane())]), solver="assembled")
