"""A body pressed flat by 200 g stays above ground, inside too, and gets up; or `diagnose` says what came through."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfem as jf
from jaxfem.building.pressed import pressed_flat

HEAVY = (0.0, 0.0, -1962.0)


def cube(**changes):
    """A soft metre, eight nodes of which are inside."""
    values = {"young": 2e4, "poisson": 0.3, "density": 1000.0, "damping": 2e-2, "name": "cube", **changes}
    return jf.SoftBody(jf.mesh.box((1.0, 1.0, 1.0), (3, 3, 3)), **values)


def scene(gravity, **contact):
    body = cube()
    return jf.Scene([body], gravity=gravity, contacts=[jf.Contact(body, jf.Plane(), name="floor", **contact)])


def pressed(built):
    """200 g for half a second, then one: the last states of both, and their infos."""
    model, params, state = built
    heavy, first = jf.rollout(model, params.replace(gravity=jnp.array(HEAVY)), state, 1 / 60, 60, every=30)
    end = jax.tree.map(lambda leaf: leaf[-1], heavy)
    light, second = jf.rollout(model, params.replace(gravity=jnp.array(HEAVY) / 200), end, 1 / 60, 60, every=30)
    return heavy, first, light, second


@pytest.mark.slow
def test_weight_at_the_start_gives_nodes_inside_their_rows():
    built = jf.build(scene(HEAVY))
    heavy, first, light, second = pressed(built)
    assert not first.status.any() and not second.status.any()
    assert heavy.positions[..., 2].min() > -1e-3
    assert second.inverted[-1] == 0 and 0.5 < float(light.positions[-1, :, 2].max()) < 1.1


@pytest.mark.slow
def test_what_came_through_is_told_with_the_remedy():
    built = jf.build(scene((0, 0, -9.81)))
    heavy, first, *_ = pressed(built)
    found = jf.diagnose(*built[:2], heavy, first)
    assert not found.ok and {"inside", "inverted"} <= {each.kind for each in found.findings}
    assert 'nodes of body "cube" are through contact "floor"' in str(found) and 'nodes="all"' in str(found)


def test_nodes_inside_below_ground_are_found_where_they_have_no_rows():
    model, params, state = jf.build(scene((0, 0, -9.81)))
    inside = np.setdiff1d(np.arange(model.nodes), cube().mesh.surface_nodes)
    state = state.replace(positions=state.positions.at[inside[0], 2].set(-0.3))
    info = jf.StepInfo(*map(jnp.asarray, (0, 1, 0.0, 0, 0)))
    (finding,) = (each for each in jf.diagnose(model, params, state, info).findings if each.kind == "inside")
    assert finding.name == "cube" and finding.amount == pytest.approx(0.3)
    assert "1 nodes of" in finding.text
    model, params, _ = jf.build(scene((0, 0, -9.81), nodes="all"))
    assert "inside" not in {each.kind for each in jf.diagnose(model, params, state, info).findings}


def test_only_what_will_be_pressed_flat_has_rows_inside():
    assert not pressed_flat(cube(), (0, 0, -9.81)) and pressed_flat(cube(), HEAVY)
    assert pressed_flat(cube(velocity=(0, 0, -50.0)), (0, 0, 0))
    counts = [
        len(jf.build(scene(gravity))[0].contacts["rough soft-ground plane"].margin)
        for gravity in (HEAVY, (0, 0, -9.81))
    ]
    mesh = cube().mesh
    assert counts == [len(mesh.points), len(mesh.surface_nodes)]
