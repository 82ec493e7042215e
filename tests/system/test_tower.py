"""A heavy box on a soft cube of a gram stands, at any tolerance: the box's corners stand on the face that bulges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf

MASS, SIDE, YOUNG = 1000.0, 0.1, 1e8
DT, STEPS = 1 / 60, 40


@pytest.fixture(scope="module")
def tower():
    mesh = jf.mesh.box((SIDE,) * 3, (2, 2, 2), tets_per_cell=12)
    soft = jf.SoftBody(mesh, young=YOUNG, poisson=0.3, density=1.0, damping=0.02)
    box = jf.RigidBody(jf.Box((SIDE,) * 3), mass=MASS, position=(SIDE / 2, SIDE / 2, 1.5 * SIDE))
    return jf.build(jf.Scene([soft, box], contacts=[jf.Contact(soft, jf.Plane()), jf.Contact(soft, box)]))


def ended(model, params, state, **changes):
    """The box's place and turning at the end, and the infos."""
    states, infos = jf.rollout(model.replace(**changes), params, state, DT, STEPS, every=STEPS)
    assert float(states.positions[0, :, 2].min()) > -1e-6  # what carries tonnes does not sink into the ground
    return np.asarray(states.rigid.positions[0, 0]), np.asarray(states.rigid.angular_velocities[0, 0]), infos


@pytest.mark.parametrize("tolerance", [1e-4, pytest.param(1e-8, marks=pytest.mark.slow), 1e-11])
def test_it_stands_centred_whatever_the_tolerance(tower, tolerance):
    model, params, state = tower
    place, spin, infos = ended(model, params, state, tolerance=jnp.asarray(tolerance))
    assert not infos.status.any() and infos.iterations.max() < 5000
    sag = MASS * 9.81 / (YOUNG * SIDE**2) * SIDE  # of a column that is pressed evenly, 1 mm
    assert place[2] == pytest.approx(1.5 * SIDE - sag, abs=0.3 * sag)
    np.testing.assert_allclose(place[:2], SIDE / 2, atol=1e-5)
    assert np.abs(spin).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "young"), [(100.0, YOUNG), (1000.0, 1e9), (1000.0, 1e10), (1e4, 1e9)])
def test_others_stand_too(tower, mass, young):
    model, params, state = tower
    params = params.replace(young=young, rigid=params.rigid.replace(mass=jnp.array([mass])))
    place, spin, infos = ended(model, params, state)
    assert not infos.status.any()
    np.testing.assert_allclose(
        place,
        [SIDE / 2, SIDE / 2, 1.5 * SIDE - mass * 9.81 / (young * SIDE)],
        atol=6e-5 + 0.3 * mass * 9.81 / (young * SIDE),
    )
    assert np.abs(spin).max() < 1e-3


@pytest.mark.parametrize(("mass", "method"), [(1000.0, "mprgp"), (1.0, "condensed")])
def test_all_rows_are_solved_for_where_a_light_body_is_held_by_rows_alone(mass, method):
    mesh = jf.mesh.box((SIDE,) * 3, (3, 3, 3), tets_per_cell=6)
    soft = jf.SoftBody(mesh, young=YOUNG, poisson=0.3, density=1.0, damping=0.02)
    box = jf.RigidBody(jf.Box((SIDE,) * 3), mass=mass, position=(SIDE / 2, SIDE / 2, 1.5 * SIDE))
    contacts = [jf.Contact(soft, other, friction=0.0) for other in (jf.Plane(), box)]
    assert jf.build(jf.Scene([soft, box], contacts=contacts))[0].method.name == method


def test_a_small_box_stands_between_the_nodes_of_a_face():
    mesh = jf.mesh.box((SIDE,) * 3, (1, 1, 1))
    soft = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, damping=0.02, fixed="z-")
    box = jf.RigidBody(jf.Box((0.02, 0.02, 0.02)), mass=0.05, position=(0.06, 0.04, SIDE + 0.012))
    scene = jf.Scene([soft, box], contacts=[jf.Contact(soft, box)])
    states, infos = jf.rollout(*jf.build(scene), 1e-2, 40)
    assert not infos.status.any()
    np.testing.assert_allclose(states.rigid.positions[-1, 0], [0.06, 0.04, SIDE + 0.01], atol=2e-4)


def test_what_stands_beside_a_soft_body_is_not_pushed():
    mesh = jf.mesh.box((SIDE,) * 3, (1, 1, 1))
    soft = jf.SoftBody(mesh, young=1e6, poisson=0.3, density=1000.0, fixed="z-")
    beside = jf.RigidBody(jf.Box((SIDE, SIDE, 0.04)), mass=0.1, position=(-SIDE / 2 - 0.002, SIDE / 2, 0.03))
    above = jf.RigidBody(jf.Box((0.05, 0.05, 0.05)), mass=0.1, position=(0.05, 0.05, SIDE + 0.03))
    contacts = [jf.Contact(soft, each, friction=0.0) for each in (beside, above)]
    model, params, state = jf.build(jf.Scene([soft, beside, above], gravity=(0, 0, 0), contacts=contacts))
    states, _ = jf.rollout(model, params, state, 1e-2, 5)
    np.testing.assert_allclose(states.rigid.positions[-1], state.rigid.positions, atol=1e-12)
    assert jax.tree.all(jax.tree.map(lambda leaf: bool(np.isfinite(leaf).all()), states))
