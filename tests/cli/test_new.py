"""Files of `jaxfem new`: they run as they are, and what is in comments is read too, line by line and table by table."""

import re
import shutil
import subprocess

import pytest
from kinds import own_alone

from jaxfem.cli.completion import SHELLS, script
from jaxfem.cli.main import COMMANDS, main, parser
from jaxfem.declared import Contact
from jaxfem.declared.joints import JOINTS
from jaxfem.inputs import inputs_of
from jaxfem.io import fit_files, load_scene, scene_bodies, scene_coupling, scene_files
from jaxfem.io.fit_template import fit_template
from jaxfem.io.templates import scene_template
from jaxfem.materials.constants import Constant
from jaxfem.materials.linear import Linear

with own_alone():
    LINES = scene_template().splitlines()
SINGLE = re.compile(r"# ([a-z_]+) = (.*)")


@pytest.fixture(autouse=True)
def _own_kinds():
    with own_alone():
        yield


def test_a_law_may_have_a_constant_more(monkeypatch):
    more = Constant("alpha", "1/K", "must be finite", default=0.5)
    monkeypatch.setattr(Linear, "constants", (*Linear.constants, more))
    assert any(line.startswith("alpha = 0.5") for line in scene_template().splitlines())


def alone(lines):
    """Numbers of commented keys that stand in a table that is there."""
    inside, found = True, []
    for number, line in enumerate(lines):
        if line.startswith(("# [[", "# [")):
            inside = False
        elif line.startswith("[") or not line:
            inside = True
        elif (
            inside
            and SINGLE.match(line)
            and not re.search("(file|surface|cage|cad) = ", line)
            and not re.match('# material = "[a-z_]+":', line)
        ):
            found.append(number)
    return found


def blocks(lines):
    """(first, last) of tables that are commented as a whole."""
    starts = [n for n, line in enumerate(lines) if line.startswith("# [")]
    ends = [next((n for n in range(start, len(lines)) if not lines[n]), len(lines)) for start in starts]
    return list(zip(starts, ends, strict=True))


def test_the_scene_runs_and_its_fit_is_read(tmp_path, capsys):
    assert main(["new", "scene", str(tmp_path / "scene.toml")]) == 0
    assert main(["simulate", str(tmp_path / "scene.toml"), "--no-plots"]) == 0
    assert (tmp_path / "results" / "scene.pvd").is_file()
    assert main(["new", "fit", str(tmp_path / "fit.toml")]) == 0
    file = fit_files.load_fit(tmp_path / "fit.toml")
    assert file.settings["parameters"] == ("young", "damping") and set(file.places) == {"tip", "side"}
    capsys.readouterr()
    assert main(["new", "fit", str(tmp_path / "fit.toml")]) == 2 and "--force" in capsys.readouterr().err
    assert main(["new", "fit", str(tmp_path / "fit.toml"), "--force"]) == 0


@pytest.mark.parametrize("number", alone(LINES), ids=lambda n: LINES[n][2:].split(" =")[0])
def test_each_key_in_comments_is_read(number, tmp_path):
    lines = list(LINES)
    key = SINGLE.match(lines[number]).group(1)
    instead = re.search(r"instead of (\w+)", lines[number])
    gone = instead.group(1) if instead else key
    before = max(n for n in range(number) if lines[n].startswith("["))
    after = next((n for n in range(number, len(lines)) if lines[n].startswith("[")), len(lines))
    lines[number] = lines[number][2:]
    others = [n for n in range(before + 1, after) if n != number and lines[n].startswith(f"{gone} =")]
    text = "\n".join(line for n, line in enumerate(lines) if n not in others)
    path = tmp_path / "scene.toml"
    path.write_text(text)
    load_scene(path)


@pytest.mark.parametrize("block", blocks(LINES), ids=lambda b: LINES[b[0] + 1][2:])
def test_each_table_in_comments_is_read(block, tmp_path):
    lines = list(LINES)
    for number in range(*block):
        if not lines[number].startswith("# of soft bodies"):
            lines[number] = lines[number].removeprefix("# ")
    path = tmp_path / "scene.toml"
    path.write_text("\n".join(lines))
    load_scene(path)


def test_a_fit_with_all_its_comments_is_read(tmp_path):
    (tmp_path / "scene.toml").write_text(scene_template())
    text = fit_template().replace("# recording = {", "#recording = {")
    (tmp_path / "fit.toml").write_text(re.sub(r"(?m)^# (\[|[a-z_]+ = )", r"\1", text))
    file = fit_files.load_fit(tmp_path / "fit.toml")
    assert file.settings["noise"].sigma == 1e-4 and len(file.settings["starts"]) == 2 and file.substeps == 2
    (tmp_path / "fit.toml").write_text(
        text.replace("#recording", "recording").replace('recording = "recording.csv" ', "# ")
    )
    assert fit_files.load_fit(tmp_path / "fit.toml").reading["rate"] == 100


def test_no_key_is_left_out():
    scene, fit = scene_template(), fit_template()
    known = (*scene_files.TIME_KEYS, *scene_files.SOLVER_KEYS, *scene_files.OUTPUT_KEYS, *scene_bodies.MESH_KEYS)
    known += (*(key for keys in scene_bodies.MESH_KEYS.values() for key in keys), *scene_bodies.MOTION_KEYS)
    known += (*scene_coupling.RIGID_KEYS, *inputs_of(Contact))
    known += tuple(key for key in scene_bodies.BODY_KEYS if key not in ("driven", "load"))
    for word in JOINTS.words():
        known += tuple(inputs_of(JOINTS[word].made))
    for key in known:
        assert re.search(rf"\b{key} =", scene), key
    for key in (*fit_files.FIT_KEYS, *fit_files.RECORDING_KEYS, *fit_files.OUTPUT_KEYS):
        assert re.search(rf"\b{key} =|fit\.{key}\]", fit), key


def test_completion_knows_every_command_and_option():
    for shell in SHELLS:
        text = script(shell, parser())
        for word in ("simulate", "view", "--resume", "--no-plots", "completion", "info"):
            assert word.removeprefix("--") in text, (shell, word)
    assert {each.__name__.rsplit(".", 1)[-1] for each in COMMANDS} >= {"simulate", "fit", "view", "sweep", "compare"}


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes(tmp_path):
    lines = script("bash", parser()) + (
        'complete_this() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _jaxfem; echo "${COMPREPLY[@]}"; }\n'
        "complete_this jaxfem sim; complete_this jaxfem simulate --re; complete_this jaxfem mesh in\n"
    )
    said = subprocess.run(["bash", "-c", lines], capture_output=True, text=True, check=True, cwd=tmp_path).stdout
    assert said.split() == ["simulate", "--resume", "info"]
