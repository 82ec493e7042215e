"""`jaxfem compare`: the same scene by several methods, each measured against a converged run."""

import json
import re

import pytest

from jaxfem.cli.compare import _cases
from jaxfem.cli.main import main
from jaxfem.io import load_scene
from jaxfem.io.scene_files import COMPARE_KEYS, SceneFileError
from jaxfem.io.templates import scene_template
from jaxfem.io.toml_tables import Table, read_toml

SCENE = """
[time]
step = 0.01
steps = 8
[[body]]
name = "beam"
mesh = { box = [0.1, 0.03, 0.03], cells = [3, 1, 1] }
young = 1e5
poisson = 0.25
density = 1000.0
fixed = "x-"
"""


def compared(tmp_path, more, capsys):
    path = tmp_path / "beam.toml"
    path.write_text(SCENE + more)
    code = main(["compare", str(path)])
    return code, capsys.readouterr()


def test_methods_and_settings_side_by_side(tmp_path, capsys):
    more = '[compare]\nmethods = ["corotated", "assembled", { method = "groupwise", groups = 2 }]\n'
    more += "step_factors = [1, 0.5]\n"
    code, said = compared(tmp_path, more + "finer = 8\n", capsys)
    assert code == 0
    folder = tmp_path / "beam_compared"
    rows = {row["label"]: row for row in json.loads((folder / "compare.json").read_text())["rows"]}
    assert (folder / "compare.png").is_file() and len((folder / "compare.csv").read_text().splitlines()) == 7
    assert rows["corotated"]["error_m"] == pytest.approx(rows["assembled"]["error_m"], rel=1e-5)
    # first order: at half the step half the error, less what the converged run itself is off
    assert rows["corotated, step x 0.5"]["error_m"] < 0.6 * rows["corotated"]["error_m"]
    assert rows["groupwise (groups 2)"]["error_m"] > 0 and "groupwise (groups 2)" in said.out


def test_what_cannot_serve_the_scene_is_left_out_by_name(tmp_path, capsys):
    more = '[compare]\nmethods = ["corotated", "direct", { method = "groupwise", groups = 9999 }]\nfiner = 2\n'
    code, said = compared(tmp_path, more, capsys)
    assert code == 0 and "left out, direct" in said.err and "ask for fewer" in said.err


@pytest.mark.parametrize(
    "line, words",
    [
        ('methods = ["magic"]', "a list of words"),
        ('methods = [{ method = "groupwise", pieces = 2 }]', "no setting 'pieces'"),
        ("step_factors = [0.3]", "divide the scene's 8 steps"),
        ("tolerances = 1e-3", "a list"),
        ("tolerances = [1e-4, 2.0]", "between 0 and 1"),
        ('methods = [{ method = "groupwise", groups = [2] }]', "'groups' in methods of [compare]"),
        ('methods = [{ method = "groupwise", enforce = "no" }]', "true or false"),
        ("speed = 1", "speed"),
        ("finer = 1", "give finer = 2 or more"),
        ("step_factors = [1, 0.125]", "give finer = 16 or more"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, capsys, line, words):
    code, said = compared(tmp_path, f"[compare]\n{line}\n", capsys)
    assert code == 2 and words in said.err


def test_errors_are_not_measured_by_a_run_that_failed(tmp_path, capsys):
    code, said = compared(tmp_path, "[solver]\nmax_iterations = 1\n[compare]\nfiner = 2\n", capsys)
    assert code == 2 and "which errors are measured by, failed: " in said.err
    assert not (tmp_path / "beam_compared").exists()


def test_the_table_stands_in_any_scene_file_and_in_the_commented_one(tmp_path):
    """Other commands read the same file; a misspelt key is refused by all of them."""
    path = tmp_path / "scene.toml"
    text = re.sub(rf"(?m)^# (\[compare\]|(?:{'|'.join(COMPARE_KEYS)}) = )", r"\1", scene_template())
    path.write_text(text)
    file = load_scene(path)
    table = Table(read_toml(path), "the top level", None).table("compare", COMPARE_KEYS, "[compare]")
    assert len(list(_cases(table, file))) == 2 * 2 * 2
    path.write_text(text + "tolerance = 1e-3\n")
    with pytest.raises(SceneFileError, match="tolerance"):
        load_scene(path)
