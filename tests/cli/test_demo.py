"""`jaxfem demo`, on a coarser beam: it runs through and finds the material again."""

import argparse
import json

import pytest

from jaxfem.cli import demo
from jaxfem.cli.main import main, parser
from jaxfem.fitting import read_recording
from jaxfem.io import SceneFileError


@pytest.mark.slow
def test_the_demo_runs_through_and_leaves_its_files(tmp_path, capsys):
    args = argparse.Namespace(out=str(tmp_path), seed=1, cells=(4, 1, 1), steps=50, force=False)
    assert demo.run(args) == 0
    told = capsys.readouterr().out
    assert "fitted/measured_against_simulated.png" in told and "+-" in told
    found = json.loads((tmp_path / "fitted" / "fitted.json").read_text())
    for name, value in demo.TRUE.items():
        assert abs(found["values"][name] - value) < 4 * found["standard_errors"][name] < 0.5 * value
    assert found["iterations"] <= 12  # from a stiffness thirty times too high
    for name in (
        "beam.toml",
        "fit.toml",
        "simulated/beam.pvd",
        "fitted/report.html",
        "fitted/loss.png",
        "fitted/residuals.csv",
    ):
        assert (tmp_path / name).is_file()
    recording = read_recording(tmp_path / "recording.csv")
    assert not recording.seen.all() and recording.names == tuple(demo.MARKERS)


def test_files_that_someone_edited_are_not_written_over(tmp_path, capsys):
    for name, text in demo._inputs((4, 1, 1), 50).items():
        (tmp_path / name).write_text(text)
    edited = (tmp_path / "beam.toml").read_text().replace("density", "# heavier\ndensity")
    (tmp_path / "beam.toml").write_text(edited)
    with pytest.raises(SceneFileError, match=r"beam.toml in .* differ.*--force"):
        demo.run(argparse.Namespace(out=str(tmp_path), seed=1, cells=(4, 1, 1), steps=50, force=False))
    assert (tmp_path / "beam.toml").read_text() == edited


def test_the_command_is_there(capsys):
    assert parser().parse_args(["demo", "--out", "x"]).out == "x"
    assert main(["demo", "--seed", "1", "--out", "/dev/null/x"]) == 2
    assert "/dev/null/x" in capsys.readouterr().err
