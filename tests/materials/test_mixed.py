"""Bodies of different laws and variants in one scene move as each does alone; regions by the mesh's groups."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.io import load_scene
from jaxfem.io.fields import computed

DT, STEPS = 1e-2, 6
ELASTIC = {"young": 2e5, "poisson": 0.3, "damping": 2e-3}
LAWS = [
    jf.Linear(**ELASTIC),
    jf.Viscoelastic(**ELASTIC, branches=[(0.6, 0.02)]),
    jf.Viscoelastic(**{**ELASTIC, "young": 1e5}, branches=[(0.2, 0.01), (0.4, 0.2)], part="all"),
    jf.CreepPlastic(**ELASTIC, yield_strain=2e-3, creep=20.0),
]


def scene_of(laws, strain):
    bodies = [
        jf.SoftBody(
            jf.mesh.box((0.1, 0.03, 0.03), 1, origin=(0, 0.1 * k, 0), name=f"body{k}"),
            density=1e3,
            material=law,
            fixed="x-",
            strain=strain,
        )
        for k, law in enumerate(laws)
    ]
    return jf.build(jf.Scene(bodies), tolerance=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_bodies_of_several_laws_move_as_each_does_alone(strain):
    laws = [*LAWS, jf.NeoHookean(**ELASTIC)] if strain == "element" else LAWS[::3]  # the first and the last
    model, params, state = scene_of(laws, strain)
    states, info = jf.rollout(model, params, state, DT, STEPS)
    assert not info.status.any() and int(info.counts["flowing"][-1]) > 0
    moved = np.asarray(states.positions - state.positions)
    for k, law in enumerate(laws):
        alone = scene_of([law], strain)
        own = np.asarray(jf.rollout(*alone, DT, STEPS)[0].positions - alone[2].positions)
        # Each to the last digits that places beside other bodies leave.
        np.testing.assert_allclose(moved[:, np.asarray(model.node_body) == k], own, atol=1e-10)
        assert k == 0 or np.abs(own - moved[:, np.asarray(model.node_body) == 0]).max() > 1e-6


@pytest.mark.slow
def test_constants_of_all_laws_are_differentiable_at_once():
    model, params, state = scene_of(LAWS, "element")

    def loss(share, creep, young):
        own = params.replace(g_1=share * params.g_1, creep=creep * params.creep, young=young * params.young)
        end = jf.rollout(model, own, state, DT, 4)[0].positions[-1]
        return 1e3 * jnp.sum((end - state.positions)[:, 2] * jnp.sin(jnp.arange(len(end))))

    check(loss, (1.0, 1.0, 1.0), h=1e-5, forwards=False)


SCENE = """
[[body]]
name = "layered"
mesh = { file = "layered.msh" }
density = 1000.0
material = "viscoelastic"
young = { core = 1e6, skin = 2e5 }
poisson = 0.3
g_1 = { core = 0.0, skin = 0.5 }
tau_1 = 0.05
fixed = { box = [[-1, -1, -1], [1e-6, 1, 1]] }
[time]
step = 0.01
steps = 4
"""


def test_regions_have_constants_of_their_own(tmp_path):
    """A branch in the skin alone: the core's elements carry the elastic stress of their strain, whatever was before."""
    plain = jf.mesh.box((0.1, 0.03, 0.03), (1, 1, 2))
    top = plain.points[plain.cells].mean(axis=1)[:, 2] > 0.015
    groups = {"core": np.flatnonzero(~top), "skin": np.flatnonzero(top)}
    jf.mesh.write(tmp_path / "layered.msh", jf.TetMesh(plain.points, plain.cells, cell_groups=groups))
    (tmp_path / "scene.toml").write_text(SCENE)
    model, params, state = load_scene(tmp_path / "scene.toml").build()
    assert params.young.shape == params.g_1.shape == (model.elements.count,)
    assert set(np.unique(params.g_1[top])) == {0.5} and set(np.unique(params.g_1[~top])) == {0.0}
    state = jf.rollout(model, params, state, DT, STEPS)[0]
    state = jax.tree.map(lambda leaf: leaf[-1], state)
    relaxed = jf.with_memory(model, params, state, "relaxed")
    ratio = np.asarray(computed(model, params, state)["von_mises"] / computed(model, params, relaxed)["von_mises"])
    np.testing.assert_allclose(ratio[~top], 1, rtol=1e-9)
    assert (ratio[top] > 1.05).all()
