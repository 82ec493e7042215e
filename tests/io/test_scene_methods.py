"""Methods and their settings in scene files."""

import pytest

import jaxfem as jf
from jaxfem.cli.main import main
from jaxfem.io.scene_files import SceneFileError, load_scene
from jaxfem.methods.groupwise import Groupwise
from jaxfem.methods.mass_spring import MassSpring

SCENE = """
[time]
step = 0.01
steps = 2
[[body]]
mesh = { box = [0.1, 0.03, 0.03], cells = [2, 1, 1] }
young = 1e5
poisson = 0.25
density = 1000.0
fixed = "x-"
[solver]
"""


def scene(tmp_path, lines):
    (tmp_path / "scene.toml").write_text(SCENE + lines)
    return load_scene(tmp_path / "scene.toml")


@pytest.mark.parametrize(
    "lines, method",
    [
        ('method = "corotated"', "condensed"),
        ('method = "assembled"', "assembled"),
        ('method = "groupwise"\ngroups = 2\nbinding = 5.0\nenforce = false', Groupwise(2, binding=5.0, enforce=False)),
        ('method = "mass_spring"\nintegration = "explicit"', MassSpring("explicit")),
    ],
)
def test_a_file_names_a_method_and_its_settings(tmp_path, lines, method):
    model, params, _ = scene(tmp_path, lines).build()
    assert model.method.name == method if isinstance(method, str) else model.method == method
    assert model.choice.reason == "asked for" and ("binding" in params.constants) == ("binding" in lines)


@pytest.mark.parametrize(
    "lines, words",
    [
        ('method = "condensed"\ngroups = 2', "groups"),
        ('method = "groupwise"\ngroups = [2]', "a number, a word"),
        ('method = "groupwise"\nenforce = 1', "true or false"),
        ('method = "finite"', "method"),
    ],
)
def test_what_a_method_does_not_have_is_refused(tmp_path, lines, words):
    with pytest.raises(SceneFileError, match=words):
        scene(tmp_path, lines)


def test_what_a_method_cannot_serve_is_refused_by_name(tmp_path):
    with pytest.raises(jf.SceneError, match='"groupwise" has groups = 0'):
        scene(tmp_path, 'method = "groupwise"\ngroups = 0').build()


def test_runs_are_written_and_gone_on_with(tmp_path):
    scene(tmp_path, 'method = "groupwise"\ngroups = 2')
    path = str(tmp_path / "scene.toml")
    assert main(["simulate", path, "--no-plots"]) == 0
    assert main(["simulate", path, "--no-plots", "--resume", "--steps", "4"]) == 0
    assert len(list((tmp_path / "scene_results" / "frames").glob("*.vtu"))) == 5
