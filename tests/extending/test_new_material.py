"""A new material law is one class: it then serves bodies, scene files, statics, modes, derivatives and fits.

Nothing here changes the package: the laws are declared in this file alone.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivatives import check

import jaxfem as jf
from jaxfem.fitting import Recording, attach, marker_positions
from jaxfem.io import SceneFileError, load_scene
from jaxfem.materials.base import LAWS
from jaxfem.materials.constants import Logarithm

SHEAR = jf.Constant("shear", "Pa", "must be > 0 Pa", label="shear modulus", low=0.0, stiffness=True)
BULK = jf.Constant("bulk", "Pa", "must be > 0 Pa", low=0.0, transform=Logarithm(), bounds=(1e-2, 1e2))
LOSS = jf.Constant("loss", "s", "must be >= 0 s", low=0.0, closed=True, default=0.0)


class ShearBulk(jf.Material, word="shear_bulk"):
    """Linear elasticity of a shear and a bulk modulus [Pa], with the damping time `loss` [s]."""

    constants = (SHEAR, BULK, LOSS)

    def stiffness(self, values):
        return 3 * values["bulk"], 2 * values["shear"]

    def damping(self, values):
        return values["loss"]


YOUNG, POISSON, DAMPING, DT = 2e5, 0.3, 2e-3, 1e-2
OWN = {"shear": YOUNG / (2 * (1 + POISSON)), "bulk": YOUNG / (3 * (1 - 2 * POISSON)), "loss": DAMPING}


def beam(strain="element", own=True, second=None, **settings):
    """A clamped beam of the law above, or of the built-in one; `second`: whether another beam's is the other."""
    bodies = []
    for number, its in enumerate((own,) if second is None else (own, second)):
        mesh = jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1), origin=(0, 0.1 * number, 0))
        law = ShearBulk(**OWN) if its else jf.Linear(YOUNG, POISSON, DAMPING)
        bodies.append(jf.SoftBody(mesh, density=1e3, material=law, fixed="x-", strain=strain, name=f"beam{number}"))
    return jf.build(jf.Scene(bodies), tolerance=1e-13, **settings)


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_it_moves_as_the_built_in_law_does_alone_and_beside_it(strain):
    own, other, mixed = beam(strain), beam(strain, own=False), beam(strain, own=True, second=False)
    assert len(mixed[0].domains) == 2 * len(own[0].domains)
    assert set(mixed[1].constants) == {"shear", "bulk", "loss", "young", "poisson", "damping", "density"}
    paths = [jf.rollout(*scene, DT, 8)[0].positions for scene in (own, other, mixed)]
    size = np.abs(paths[1] - other[2].positions).max()
    assert size > 1e-3
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-12)
    both = np.asarray(paths[2]) - np.asarray(mixed[2].positions)
    np.testing.assert_allclose(both, np.concatenate([paths[0] - own[2].positions] * 2, axis=1), atol=1e-11)


def test_statics_modes_stress_and_energies_know_it():
    from jaxfem.io.fields import computed

    own, other, mixed = beam(), beam(own=False), beam(own=True, second=False)
    rests = [jf.equilibrium(*scene)[0] for scene in (own, other, mixed)]
    np.testing.assert_allclose(rests[0].positions, rests[1].positions, atol=1e-11)
    pairs = list(zip((own, other, mixed), rests, strict=True))
    stress = [computed(*scene[:2], rest)["von_mises"] for scene, rest in pairs]
    energies = [jf.energies(*scene[:2], rest) for scene, rest in pairs]
    np.testing.assert_allclose(stress[0], stress[1], rtol=1e-8)
    np.testing.assert_allclose(stress[2], np.tile(stress[1], 2), rtol=1e-6)
    np.testing.assert_allclose(energies[0].elastic, energies[1].elastic, rtol=1e-9)
    frequencies = [jf.modes(*scene, count=3)[0] for scene in (own, other)]
    np.testing.assert_allclose(frequencies[0], frequencies[1], rtol=1e-9)


@pytest.mark.slow
def test_derivatives_in_its_constants():
    model, params, state = beam()

    def loss(shear, bulk, loss):
        own = params.replace(shear=shear * OWN["shear"], bulk=bulk * OWN["bulk"], loss=loss * OWN["loss"])
        return 1e2 * jf.rollout(model, own, state, DT, 5)[0].positions[-1, -1, 2]

    check(loss, (1.0, 1.1, 0.9))


def test_changing_its_constants_compiles_nothing():
    from jaxfem.stepping.step import _step

    model, params, state = beam()
    jf.step(model, params, state, DT)
    before = _step._cache_size()
    jf.step(model, params.replace(shear=1e4, loss=0.0), state, DT)
    again, others, start = beam()  # a law is known by its class and options, not by the object
    jf.step(again, others, start, DT)
    assert _step._cache_size() == before


SCENE = """
[time]
step = 0.01
steps = 4
[[body]]
name = "beam"
mesh = { box = [0.1, 0.03, 0.03], cells = [3, 1, 1] }
material = "shear_bulk"
shear = 1e5
bulk = 2e5
density = 1000.0
"""


def test_scene_files_name_it(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    model, params, _ = load_scene(path).build()
    assert isinstance(model.laws[0], ShearBulk) and float(params.bulk) == 2e5 and float(params.loss) == 0
    wrong = {
        "shear =": ("shaer =", "unknown key 'shaer' in .*did you mean 'shear'"),
        "bulk = 2e5\n": ("", "missing key 'bulk' in .*give it in Pa"),
        "bulk = 2e5": ("bulk = 2e5\nyoung = 1e5", "unknown key 'young'"),
        "shear_bulk": ("shear_bolk", "did you mean 'shear_bulk'"),
    }
    for old, (new, text) in wrong.items():
        path.write_text(SCENE.replace(old, new))
        with pytest.raises(SceneFileError, match=text):
            load_scene(path)


@pytest.mark.slow
def test_a_fit_recovers_its_constant():
    model, params, state = beam()
    markers = attach(model, {"tip": (0.1, 0.015, 0.03), "middle": (0.05, 0.015, 0.03), "side": (0.07, 0.0, 0.01)})
    states, _ = jf.rollout(model, params, state, DT, 20)
    first = marker_positions(markers, state.positions)[None]
    places = np.concatenate([first, marker_positions(markers, states.positions)])
    recording = Recording(np.arange(21) * DT, places, markers.names)
    guess = params.replace(shear=4 * params.shear)
    result = jf.fit(model, guess, state, recording, markers, parameters=["shear"], dt=DT)
    assert result.values == pytest.approx({"shear": OWN["shear"]}, rel=1e-5)
    assert float(result.params.shear) == pytest.approx(OWN["shear"], rel=1e-5) and "Pa" in result.summary()
    with pytest.raises(jf.FitError, match='cannot fit "young"; known: shear, bulk, loss, density, delay'):
        jf.fit(model, params, state, recording, markers, parameters=["young"], dt=DT)


def test_what_cannot_be_is_refused_by_name():
    mesh = jf.mesh.box((0.1, 0.03, 0.03), (3, 1, 1), name="beam")
    with pytest.raises(jf.MaterialError, match="ShearBulk needs bulk"):
        ShearBulk(shear=1e5)
    with pytest.raises(jf.MaterialError, match="ShearBulk has no constant 'young'; it has shear, bulk, loss"):
        ShearBulk(shear=1e5, bulk=1e5, young=1e5)
    with pytest.raises(jf.MaterialError, match='shear of element 1 of "beam" is -1: it must be > 0 Pa'):
        values = np.where(np.arange(len(mesh.cells)) == 1, -1.0, 1e5)
        jf.SoftBody(mesh, density=1e3, material=ShearBulk(shear=values, bulk=1e5))
    with pytest.raises(jf.MaterialError, match='"beam" has a material and young'):
        jf.SoftBody(mesh, young=1e5, density=1e3, material=ShearBulk(shear=1e5, bulk=1e5))

    class Clash(jf.Material, word="clash"):
        constants = (jf.Constant("shear", "GPa", "must be > 0"), BULK)
        stiffness = ShearBulk.stiffness

    bodies = [jf.SoftBody(mesh, density=1e3, material=law(shear=1e5, bulk=1e5)) for law in (ShearBulk, Clash)]
    with pytest.raises(jf.SceneError, match="calls a constant 'shear', which is something else"):
        jf.build(jf.Scene(bodies))
    with pytest.raises(TypeError, match=r'calls itself material "clash", which .*Clash is'):
        type("Other", (jf.Material,), {}, word="clash")
    LAWS.remove("clash")


SHARE = jf.Constant("share", "", "must be >= 0", low=0.0, closed=True)
TIME = jf.Constant("relaxation", "s", "must be > 0 s", low=0.0)
RATE = jf.Constant("creep", "1/s", "must be >= 0 1/s", low=0.0, closed=True)


class Maxwell(ShearBulk, word="maxwell"):
    """A spring with `share` times its stiffness beside it, which relaxes (Simo & Hughes 1998, chapter 10)."""

    constants = (*ShearBulk.constants, SHARE, TIME)
    options: ClassVar = {"whole": True}  # whether the volumetric part relaxes too

    def internal0(self, strain):
        return {"branch": jnp.zeros_like(strain), "strain": strain}

    def _numbers(self, values, dt):
        kept = jnp.exp(-dt / values["relaxation"])
        return kept, values["share"] * (1 - kept) * values["relaxation"] / dt

    def _relaxing(self, rows):
        return np.array([self.whole, *[True] * 5], float)[rows, None]

    def response(self, values, internal, dt, rows):
        kept, gain = self._numbers(values, dt)
        gains = self._relaxing(rows) * gain
        offset = (kept * internal["branch"] - gains * internal["strain"]) / (1 + gains)
        return jf.Response((1 + self.whole * gain, 1 + gain), offset)

    def commit(self, values, internal, strain, dt, rows):
        kept, gain = self._numbers(values, dt)
        gains = self._relaxing(rows) * gain
        return {"branch": kept * internal["branch"] + gains * (strain - internal["strain"]), "strain": strain}


class Creep(ShearBulk, word="creep"):
    """Strain that flows: e_p grows by min(dt creep, 1) of the elastic strain after each step."""

    constants = (*ShearBulk.constants, RATE)

    def internal0(self, strain):
        return jnp.zeros_like(strain)

    def response(self, values, internal, dt, rows):
        return jf.Response((1.0, 1.0), -internal)

    def commit(self, values, internal, strain, dt, rows):
        return internal + jnp.minimum(dt * values["creep"], 1) * (strain - internal)

    def rest_strain(self, values, internal, rows):
        return internal


POINTS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.02, 0.03, 0.1]])
BRANCH, TAU, FLOW = 0.7, 0.03, 6.0
MEMORIES = {
    "maxwell": Maxwell(share=BRANCH, relaxation=TAU, **OWN),
    "maxwell_shear": Maxwell(share=BRANCH, relaxation=TAU, whole=False, **OWN),
    "creep": Creep(creep=FLOW, **OWN),
}


def remembered(name, memory, strain):
    """Stress of the memory over that of the strain alone: (factor on the strain, known strain); 3x3 matrices."""
    old, before = memory
    if name == "creep":
        return strain - before
    kept, change = np.exp(-DT / TAU), strain - old
    if name == "maxwell_shear":
        change = change - np.trace(change) / 3 * np.eye(3)
    return strain + kept * before + BRANCH * (1 - kept) * TAU / DT * change


def hand_step(name, x, v, memory):
    """One step of one tetrahedron with its last node free: exact, because the momentum balance is linear in v."""
    shape = np.linalg.inv(np.c_[np.ones(4), POINTS])[1:].T  # gradients of the shape functions, (4, 3)
    volume, weight = abs(np.linalg.det(POINTS[1:] - POINTS[0])) / 6, 1e3 * np.array([0, 0, -9.81])
    left, _, right = np.linalg.svd(x.T @ shape)
    turn = left @ right
    lam = OWN["bulk"] - 2 * OWN["shear"] / 3

    def sym(a):
        return (a + a.T) / 2

    def stressed(strain):
        return lam * np.trace(strain) * np.eye(3) + 2 * OWN["shear"] * strain

    def balance(new):
        rate = sym(turn.T @ np.outer(new, shape[3]))
        strain = sym(turn.T @ (x.T @ shape)) - np.eye(3) + DT * rate
        stress = stressed(remembered(name, memory, strain)) + stressed(OWN["loss"] * rate)
        mass = 1e3 * volume / 4
        return mass * (new - v) - DT * (volume / 4 * weight - volume * turn @ stress @ shape[3])

    known = balance(np.zeros(3))
    new = np.linalg.solve(np.stack([balance(e) - known for e in np.eye(3)], 1), -known)
    moved = x + DT * np.outer([0, 0, 0, 1], new)
    left, _, right = np.linalg.svd(moved.T @ shape)
    end = sym((left @ right).T @ (moved.T @ shape)) - np.eye(3)
    if name == "creep":
        return moved, new, (end, memory[1] + min(DT * FLOW, 1) * (end - memory[1]))
    return moved, new, (end, remembered(name, memory, end) - end)


@pytest.mark.parametrize("name", MEMORIES)
def test_a_law_with_a_memory_agrees_with_a_computation_by_hand(name):
    body = jf.SoftBody(jf.TetMesh(POINTS, [[0, 1, 2, 3]]), density=1e3, material=MEMORIES[name], fixed=[0, 1, 2])
    # Pulled far: the free node starts a tenth of the height away.
    model, params, state = jf.build(jf.Scene([body]), tolerance=1e-14)
    state = state.replace(positions=state.positions.at[3].add(np.array([0.02, -0.01, 0.01])))
    x, v, memory = np.asarray(state.positions), np.zeros(3), (np.zeros((3, 3)), np.zeros((3, 3)))
    for _ in range(8):
        state, info = jf.step(model, params, state, DT)
        x, v, memory = hand_step(name, x, v, memory)
        assert int(info.status) == 0
        np.testing.assert_allclose(state.positions, x, atol=1e-11)
    assert np.abs(np.asarray(state.internal[0]["strain"] if "maxwell" in name else state.internal[0])).max() > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["element", "smoothed"])
def test_memories_on_every_kind_of_domains_beside_bodies_without(strain):
    """No share, no flow: the plain law, step for step; a body without a memory remembers nothing; derivatives."""
    laws = [Maxwell(share=BRANCH, relaxation=TAU, **OWN), Creep(creep=FLOW, **OWN), ShearBulk(**OWN)]
    meshes = [jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1), origin=(0, 0.1 * k, 0), name=f"beam{k}") for k in range(3)]
    shared = {"density": 1e3, "fixed": "x-", "strain": strain}
    bodies = [jf.SoftBody(mesh, material=law, **shared) for mesh, law in zip(meshes, laws, strict=True)]
    model, params, state = jf.build(jf.Scene(bodies), tolerance=1e-13)
    assert [each is None for each in state.internal] == [type(each.law) is ShearBulk for each in model.domains]

    def tips(share, flow, steps=6):
        own = params.replace(share=jnp.asarray(share), creep=jnp.asarray(flow))
        after = jf.rollout(model, own, state, DT, steps)[0].positions[-1]
        return (after - state.positions).reshape(3, -1, 3)

    plain = tips(0.0, 0.0)
    np.testing.assert_allclose(plain[0], plain[2], atol=1e-11)
    np.testing.assert_allclose(plain[1], plain[2], atol=1e-11)
    moved = tips(BRANCH, FLOW)
    np.testing.assert_allclose(moved[2], plain[2], atol=1e-11)
    sag = -np.asarray(moved)[:, -1, 2]
    assert sag[0] < 0.95 * sag[2] < 1.05 * sag[2] < sag[1]  # stiffer while it relaxes; softer as it flows
    check(lambda share, flow: 1e2 * jnp.sum(tips(share, flow, 4)[:2, -1, 2]), (BRANCH, FLOW))


def test_energies_count_from_the_strain_at_rest_and_what_needs_none_refuses_a_memory():
    body = jf.SoftBody(jf.TetMesh(POINTS, [[0, 1, 2, 3]]), density=1e3, material=MEMORIES["creep"], fixed=[0, 1, 2])
    scene = model, params, state = jf.build(jf.Scene([body]))
    moved = state.replace(positions=state.positions.at[3].add(np.array([0.02, -0.01, 0.01])))
    flowed = moved.replace(internal=jax.tree.map(jnp.copy, moved.internal))
    held, _ = jf.step(model, params.replace(creep=1e9), moved, 1e-9)  # all strain flows at once, nothing moves
    assert float(jf.energies(model, params, flowed).elastic) > 1e-3
    assert float(jf.energies(model, params, held).elastic) < 1e-12
    with pytest.raises(jf.StepError, match="equilibrium takes materials without a memory"):
        jf.equilibrium(*scene)
    with pytest.raises(jf.StepError, match="modes takes materials without a memory"):
        jf.modes(*scene)
    with pytest.raises(jf.SceneError, match='Creep, the material of "mesh", has a memory'):
        jf.build(jf.Scene([body]), scheme="generalized_alpha")
    with pytest.raises(jf.StepError, match="internal belongs to materials with a memory"):
        jf.step(model, params, state.replace(internal=None), DT)
