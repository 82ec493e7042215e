"""`jaxfem mesh info`, and the command line's own errors."""

import subprocess
import sys

import pytest

import jaxfem as jf
from jaxfem.cli.main import main


def test_report(tmp_path, capsys):
    jf.mesh.write(tmp_path / "part.msh", jf.mesh.box((200, 100, 100), (2, 1, 1)))
    assert main(["mesh", "info", str(tmp_path / "part.msh"), "--scale", "1e-3"]) == 0
    said = capsys.readouterr()
    for part in ('mesh "part"', "0.2 x 0.1 x 0.1 m", "12", "x- (2)"):
        assert part in said.out
    assert said.err == ""


def test_unreadable(tmp_path, capsys):
    assert main(["mesh", "info", str(tmp_path / "none.msh")]) == 2
    assert "jaxfem: error: no mesh file" in capsys.readouterr().err
    (tmp_path / "bad.msh").write_text("nonsense")
    assert main(["mesh", "info", str(tmp_path / "bad.msh")]) == 2
    assert "cannot read" in capsys.readouterr().err
    assert main(["mesh", "info", str(tmp_path / "bad.msh"), "--scale", "-1"]) == 2
    assert "scale=-1" in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["mesh"], ["simulte", "a.toml"], ["simulate"]])
def test_usage(words, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2 and "usage: jaxfem" in capsys.readouterr().err


def test_as_a_program():
    """The process's exit code and streams, once."""
    command = [sys.executable, "-m", "jaxfem.cli.main", "mesh", "info", "none.msh"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == "" and "jaxfem: error: no mesh file none.msh" in done.stderr


def test_merge(tmp_path, capsys):
    box = jf.mesh.box((0.1, 0.1, 0.1), 1)
    points, cells = [*box.points, *box.points], box.cells
    jf.mesh.write(tmp_path / "two.vtu", jf.TetMesh(points, [*cells, *(cells + 8)]))
    assert main(["mesh", "info", str(tmp_path / "two.vtu")]) == 0
    assert "16 nodes lie on top of another" in capsys.readouterr().out
    assert main(["mesh", "info", str(tmp_path / "two.vtu"), "--merge"]) == 0
    said = capsys.readouterr().out
    assert "note: 8 nodes were merged" in said and "warning" not in said
