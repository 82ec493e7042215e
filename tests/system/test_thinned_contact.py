"""Surfaces much finer than their mesh: a few vertices a node touch, and hold as all of them would."""

import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import Parted

import jaxfem as jf
from jaxfem.building.embedded import embedded
from jaxfem.rows.candidates import pairs_of
from jaxfem.rows.contact import DEEP
from jaxfem.rows.thinned import ThinnedContacts
from jaxfem.system.coupled import configuration

SKIN = jf.mesh.box((0.12, 0.12, 0.12), 8, origin=(-0.06, -0.06, -0.06))
SKIN = SKIN.points[SKIN.surface_nodes]
FLOOR = -0.0601


def block(name="block", **more):
    mesh = jf.mesh.box((0.2, 0.2, 0.2), 2, origin=(-0.1, -0.1, -0.1))
    return jf.SoftBody(mesh, 2e5, 0.3, 1000.0, damping=2e-3, name=name, **more)


def standing(per_node, **more):
    body = block()
    contact = jf.Contact(body, jf.Plane((0, 0, FLOOR)), friction=0.5, surface=SKIN, per_node=per_node)
    return jf.build(jf.Scene([body], contacts=[contact]), **more)


@pytest.mark.parametrize("partner", ["ground", "rigid", "soft"])
def test_the_deepest_of_each_nodes_vertices_is_taken(partner):
    """Whatever the partner: where the body is bent at random, no vertex near a node is deeper than the one taken."""
    body = block()
    slab = jf.mesh.box((0.3, 0.3, 0.1), 2, origin=(-0.15, -0.15, -0.2))
    other = {
        "ground": jf.Plane((0, 0, FLOOR)),
        "rigid": jf.RigidBody(jf.Sphere(0.1), mass=1.0, position=(0.0, 0.02, -0.2)),
        "soft": jf.SoftBody(slab, 1e5, 0.3, 1000.0, name="slab"),
    }[partner]
    bodies = [body] if partner == "ground" else [body, other]
    model, _, state = jf.build(jf.Scene(bodies, contacts=[jf.Contact(body, other, surface=SKIN)]))
    (few,) = (each for each in model.contacts.values() if isinstance(each, ThinnedContacts))
    shift = 0.02 * np.random.default_rng(0).standard_normal(state.positions.shape)
    at = configuration(state.replace(positions=state.positions + shift))
    gap, taken = (np.asarray(pairs_of(each, at).gap) for each in (few.every, few))
    taken = taken.reshape(-1, few.most)
    table = np.asarray(few.table)
    assert len(gap) == len(SKIN) > 2 * taken.size and set(table[table >= 0]) == set(range(len(gap)))
    least = np.where(table >= 0, gap[table], np.inf).min(1)
    np.testing.assert_allclose(taken.min(1), least, atol=1.01 * DEEP * float(few.margin[0]), rtol=0)


@pytest.mark.slow
def test_few_hold_as_all_of_them_do():
    """It drops on a flat side: on two vertices a node every node moves as on all 81 of that side, to a thousandth of
    the skin's size, it stands as high to a ten thousandth, and they carry its weight."""
    runs = []
    for per_node in (2, len(SKIN)):
        model, params, state = standing(per_node)
        thinned = [isinstance(each, ThinnedContacts) for each in model.contacts.values()]
        assert all(thinned) if per_node == 2 else not any(thinned)
        states, info = jf.rollout(model, params, state, 1e-2, 40, every=5)
        assert not info.status.any()
        cells, weights = embedded(block().mesh, SKIN, "surface")
        assert np.einsum("qk,qki->qi", weights, states.positions[-1][cells])[:, 2].min() > FLOOR - 1e-4
        found = jf.impulses(model, states)
        push = sum(float(jnp.sum(found[f"contact {name}"][-1])) for name in model.contacts)
        assert push == pytest.approx(8.0 * 9.81 * 1e-2, rel=0.05)
        runs.append(states.positions)
    np.testing.assert_allclose(*runs, atol=1.2e-4)
    np.testing.assert_allclose(*[run[-1, :, 2].mean() for run in runs], atol=1.2e-5)


@pytest.mark.slow
def test_derivatives_go_through_those_that_touch():
    model, params, state = standing(2, tolerance=1e-12)

    @Parted
    def place(young):
        return jf.rollout(model, params.replace(young=young * params.young), state, 5e-3, 4)[0].positions[-1].sum()

    slope = float(*place.backwards(1.0))
    central = float(place(1 + 1e-5) - place(1 - 1e-5)) / 2e-5
    assert slope == pytest.approx(central, rel=1e-5) and abs(slope) > 1e-8


@pytest.mark.parametrize("per_node", [0, 1.5, True])
def test_a_number_that_makes_no_sense_is_refused(per_node):
    with pytest.raises(jf.SceneError, match=r"per_node of .* whole number of at least 1"):
        jf.Contact("a", jf.Plane(), surface=True, per_node=per_node)
