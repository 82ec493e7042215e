"""Creep plasticity against a computation by hand in 3x3 tensors; sets, dissipation, derivatives, lanes and counts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.io import SceneFileError, load_scene
from jaxfem.tensors import array_of, from_eigenbasis

POINTS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.02, 0.03, 0.1]])
LAW = {"young": 2e5, "poisson": 0.3, "damping": 2e-3, "yield_strain": 0.03, "creep": 15.0, "maximum": 0.05}
DT = 1e-2


def by_hand(strain, plastic, overshoot=False, volume_preserving=False):
    """Algorithm 1 on symmetric 3x3 tensors with the Frobenius norm."""
    elastic = strain - plastic
    if volume_preserving:
        elastic = elastic - np.trace(elastic) / 3 * np.eye(3)
    size = np.linalg.norm(elastic)
    if size > LAW["yield_strain"]:
        share = min(DT * LAW["creep"], 1 if overshoot else 1 - LAW["yield_strain"] / size)
        plastic = plastic + share * elastic
    if np.linalg.norm(plastic) > LAW["maximum"]:
        plastic = plastic * LAW["maximum"] / np.linalg.norm(plastic)
    return plastic


def strain_of(x):
    """Strain of the one tetrahedron in its rotated frame."""
    deformation = (x[1:] - x[0]).T @ np.linalg.inv((POINTS[1:] - POINTS[0]).T)
    _, stretch, right = np.linalg.svd(deformation)
    return right.T @ np.diag(stretch) @ right - np.eye(3)


@pytest.mark.parametrize("options", [{}, {"overshoot": True}, {"volume_preserving": True}])
def test_the_strain_path_of_one_element_agrees_with_a_computation_by_hand(options):
    material = jf.CreepPlastic(**LAW, **options)
    body = jf.SoftBody(jf.TetMesh(POINTS, [[0, 1, 2, 3]]), density=1e3, material=material, fixed=[0, 1, 2])
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-12)
    plastic, flowed, largest = np.zeros((3, 3)), [], 0.0
    for step in range(60):
        # Pulled, held, pushed the other way: through yield, up to the maximum, and back.
        place = np.array([0.02, -0.01, 0.03]) * min(step, 15) / 15 * (1 if step < 40 else -1.2)
        state = state.replace(positions=jnp.asarray(POINTS).at[3].add(place))
        state, info = jf.step(model, params, state, DT)
        before, plastic = plastic, by_hand(strain_of(np.asarray(state.positions)), plastic, **options)
        found = np.asarray(array_of(from_eigenbasis(list(state.internal[0]))))[..., 0]
        np.testing.assert_allclose(found, plastic, atol=1e-12)
        flowed.append(np.any(before != plastic))
        largest = max(largest, np.linalg.norm(plastic))
        assert int(info.counts["flowing"]) == flowed[-1]
    assert 0 < sum(flowed) < 60 and largest > 0.999 * LAW["maximum"]


@pytest.mark.parametrize("poisson", [0.3, 0.499])
def test_dissipation_is_never_negative(poisson):
    law = jf.CreepPlastic(**{**LAW, "poisson": poisson, "maximum": 0.2})
    rows, rng = slice(0, 6), np.random.default_rng(2)
    weights = np.array([law.stiffness(law.values)[0], *[law.stiffness(law.values)[1]] * 5])[:, None]
    plastic = law.internal0(jnp.zeros((6, 200)))
    capped = False
    for _ in range(60):
        strain = jnp.asarray(0.2 * rng.standard_normal((6, 200)))
        after = law.commit(law.values, plastic, strain, 0.02, rows)
        lost = 0.5 * np.sum(weights * np.asarray((strain - plastic) ** 2 - (strain - after) ** 2), axis=0)
        assert lost.min() >= -1e-12 * np.abs(weights).max()
        capped |= bool(np.any(np.linalg.norm(after, axis=0) > 0.1999))
        plastic = after
    assert capped


def bar(strain="element", cells=(2, 1, 1), **settings):
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells)
    material = jf.CreepPlastic(
        **{**LAW, "yield_strain": 0.01, "damping": 0.02, "maximum": 0.15}, volume_preserving=True
    )
    body = jf.SoftBody(mesh, density=1e3, material=material, fixed="x-", strain=strain, name="bar")
    return jf.build(jf.Scene([body], gravity=(0, 0, 0)), **{"tolerance": 1e-12, **settings})


def pressed(scene, params, dt, press=0.4, total=0.8):
    """Where the tip of a bar is after a press at it, and a release."""
    model, _, state = scene
    steps, held = round(total / dt), round(press / dt)
    force = np.zeros((steps, *model.rest.shape))
    force[:held, np.asarray(model.rest)[:, 0] > 0.099, 2] = -0.6
    states, info = jf.rollout(model, params, state, dt, steps, forces=jnp.asarray(force), every=steps)
    return states.positions[-1, -1, 2] - model.rest[-1, 2], info


@pytest.mark.slow
def test_a_bent_bar_keeps_the_set_of_a_run_at_a_hundredth_of_the_step():
    scene = bar()
    sets = [float(pressed(scene, scene[1], dt)[0]) for dt in (2e-2, 2e-4)]
    assert sets[1] < -2e-3  # it stays bent
    assert abs(sets[0] / sets[1] - 1) < 0.01, sets


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_derivatives_lanes_and_counts(strain):
    scene = _, params, _ = bar(strain)

    def tip(yield_strain, creep, young=1.0):
        """Of shares of the law's values, so that one step of differences suits all."""
        own = params.replace(yield_strain=0.01 * yield_strain, creep=12 * creep, young=2e5 * young)
        moved, info = pressed(scene, own, 2e-2, 0.1, 0.14)
        return 1e2 * moved, info

    run = check(tip, (1.0, 1.0, 1.0), has_aux=True, forwards=strain == "element")
    creeps = jnp.array([0.0, 0.4, 3.0])
    lanes = jax.jit(jax.vmap(lambda creep: tip(1.0, creep)[0]))(creeps)
    np.testing.assert_allclose(lanes, [run(1.0, creep, 1.0)[0] for creep in creeps], atol=1e-9)
    _, info = run(1.0, 1.0, 1.0)
    assert int(info.counts["flowing"][0]) > 0 and [each is None for each in scene[2].internal].count(False) == 1


def test_states_at_the_edge_of_yield_are_counted():
    law, rows = jf.CreepPlastic(**LAW), slice(0, 6)
    strain = jnp.zeros((6, 4)).at[2].set(jnp.array([0.0, 0.02, 0.03, 0.04]))
    plastic = law.internal0(strain)
    after = law.commit(law.values, plastic, strain, 1.0, rows)
    assert {k: int(v) for k, v in law.counts(law.values, plastic, after, strain, 1.0, rows).items()} == {
        "flowing": 1,
        "at_yield": 1,
    }
    again = law.commit(law.values, after, strain, 1.0, rows)  # flowed back to the surface, it stays there
    np.testing.assert_allclose(again, after, atol=1e-17)
    assert int(law.counts(law.values, after, again, strain, 1.0, rows)["at_yield"]) == 2


SCENE = """
[time]
step = 0.01
steps = 4
[[body]]
name = "bar"
mesh = { box = [0.1, 0.03, 0.03], cells = [1, 1, 1] }
material = "creep_plastic"
young = 1e5
poisson = 0.3
density = 1000.0
yield_strain = 0.01
creep = 10.0
volume_preserving = true
"""


def test_scene_files_name_it(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    model, params, state = load_scene(path).build()
    assert model.laws[0].volume_preserving and float(params.creep) == 10 and state.internal[0].shape == (6, 6)
    path.write_text(SCENE.replace("creep = 10.0", "creep = -1.0"))
    with pytest.raises(jf.MaterialError, match='creep of "bar" is -1: it must be >= 0 1/s'):
        load_scene(path)
    path.write_text(SCENE.replace("= true", "= 1"))
    with pytest.raises(SceneFileError, match="'volume_preserving' in"):
        load_scene(path)
