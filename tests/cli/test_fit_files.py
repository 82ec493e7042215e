"""What fit files say is what the search is given; mistakes in them are named."""

import re

import pytest

import jaxfem as jf
from jaxfem.fitting import silicone
from jaxfem.io.examples import beam_scene
from jaxfem.io.fit_files import SEARCH_KEYS, load_fit
from jaxfem.io.scene_files import SceneFileError

FIT = """
scene = "scene.toml"
recording = "recording.csv"
[markers]
tip = [0.1, 0.015, 0.036]
[fit]
parameters = ["young", "damping"]
release = 0.0
[output]
folder = "out"
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.toml").write_text(beam_scene(3e6, damping=3e-4, cells=(3, 1, 1), tets_per_cell=6, steps=40))
    return tmp_path


def test_priors_are_read(folder):
    extra = """[fit.priors]
young = { silicone = "dragon skin 10 medium" }
damping = { median = 3e-3, factor = 2 }
[output]"""
    (folder / "priors.toml").write_text(FIT.replace("[output]", extra))
    priors = load_fit(folder / "priors.toml").settings["priors"]
    assert priors["young"] == silicone("Dragon Skin 10 Medium") and priors["young"].factor == 2
    assert priors["young"].median == pytest.approx(145.8e3, rel=1e-3)
    for text, message in (
        ('{ silicone = "Dragon Skn 20" }', 'did you mean "Dragon Skin 20"?'),
        ('{ silicone = "rubber" }', "known: Ecoflex 00-10"),
        ('{ silicone = "Dragonskin 10" }', 'did you mean "Dragon Skin 10 Medium"?'),
    ):
        (folder / "priors.toml").write_text(FIT.replace("[output]", f"[fit.priors]\nyoung = {text}\n[output]"))
        with pytest.raises(SceneFileError, match=re.escape(message)):
            load_fit(folder / "priors.toml")
    (folder / "priors.toml").write_text(
        FIT.replace("[output]", "[fit.priors]\ndensity = { mean = 1, deviation = 1 }\n[output]")
    )
    with pytest.raises(SceneFileError, match=re.escape("'density' in [fit.priors] is not fitted")):
        load_fit(folder / "priors.toml")
    assert silicone("Ecoflex 00-30", "c1", 1.5) == jf.LogNormal(7.83e3, 1.5)
    with pytest.raises(jf.FitError, match="known by young, c1 and c2"):
        silicone("Ecoflex 00-30", "damping")


def test_settings_are_read(folder):
    extra = "[fit.starts]\nyoung = [1e5, 1e6]\n[fit.bounds]\nyoung = [1e3, 1e7]\n[output]"
    text = FIT.replace("[output]", extra).replace("[fit]", '[fit]\nframe = "all"\nend = "settled"\nsubsteps = 3')
    (folder / "full.toml").write_text(text)
    text = text.replace('"recording.csv"', '{ file = "r.csv", unit = "mm", rate = 100 }').replace(
        "[fit]",
        '[fit]\nchecks = "warn"\nmulti_start = 8\nwindows = 3\nmax_memory = 0.5\nplaces = 1e-3\nengine = "vmap"',
    )
    (folder / "full.toml").write_text(text)
    file = load_fit(folder / "full.toml")
    assert file.recording.name == "r.csv" and file.reading == {"unit": "mm", "rate": 100, "camera": None}
    assert file.settings["checks"] == "warn"
    assert file.substeps == 3 and file.settings["starts"] == [{"young": 1e5}, {"young": 1e6}]
    assert file.settings["bounds"] == {"young": (1e3, 1e7)} and file.cutting["end"] == "settled"
    assert {key: file.settings[key] for key in SEARCH_KEYS} == dict(
        zip(SEARCH_KEYS, (8, 0, 3, 0.5, 1e-3, "vmap"), strict=True)
    )
