"""A new material law is one class: it then serves bodies, scene files, statics, modes, derivatives and fits.

Nothing here changes the package: the laws are declared in this file alone.
"""

import warnings

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
    own, mixed = beam(strain), beam(strain, own=True, second=False)
    assert len(mixed[0].domains) == 2 * len(own[0].domains)
    assert set(mixed[1].constants) == {"shear", "bulk", "loss", "young", "poisson", "damping", "density"}
    alone, both = (np.asarray(jf.rollout(*s, DT, 8)[0].positions - s[2].positions) for s in (own, mixed))
    assert np.abs(alone).max() > 1e-3
    here, there = np.split(both, 2, axis=1)  # its body, and the built-in law's
    np.testing.assert_allclose(here, there, atol=1e-12)
    np.testing.assert_allclose(here, alone, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["assembled", "groupwise", "mass_spring"])
def test_methods_with_a_step_of_their_own_take_it_for_the_linear_law_that_it_is(solver):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jf.AccuracyWarning)  # springs have a Poisson's ratio of their own
        scenes = [beam(own=own, solver=solver) for own in (True, False)]
    here, there = (np.asarray(jf.rollout(*s, 1e-3, 8)[0].positions - s[2].positions) for s in scenes)
    assert np.abs(there).max() > 1e-5
    np.testing.assert_allclose(here, there, atol=1e-9 * np.abs(there).max())


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

    check(loss, (1.0, 1.1, 0.9), forwards=False)


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
        type("Other", (jf.Material,), {"stiffness": ShearBulk.stiffness}, word="clash")
    LAWS.remove("clash")
