"""`jaxfem simulate --resume`, and the bar that tells the time left."""

import numpy as np
from test_simulate import rows, scene, simulated

from jaxfem.cli import progress
from jaxfem.io import read_frames

__all__ = ["scene"]  # a fixture


def test_a_run_goes_on_where_it_stopped(scene, tmp_path, capsys):
    """Frames, tables and the end are those of a run without a break; old results are not written over unasked."""
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert simulated(scene(every=2), "--no-plots", "--out", str(whole)) == 0
    assert simulated(scene(every=2), "--no-plots", "--steps", "4") == 0
    assert simulated(scene(every=2), "--no-plots", "--no-force") == 2
    said = capsys.readouterr().err
    assert "lists 3 frames" in said and "--resume" in said and "--force" in said
    assert simulated(scene(every=2), "--no-plots", "--resume") == 0
    assert "6 of 6 steps" in capsys.readouterr().out
    for name in ("energies.csv", "points.csv"):
        assert rows(out / name) == rows(whole / name)
    ours, theirs = read_frames(out / "run.pvd"), read_frames(whole / "run.pvd")
    assert [frame.time for frame in ours] == [frame.time for frame in theirs] and len(ours) == 4
    np.testing.assert_array_equal(ours[-1].positions, theirs[-1].positions)
    assert simulated(scene(every=2), "--no-plots", "--resume") == 2 and "6 steps already" in capsys.readouterr().err
    other = scene("[[body]]\nmesh = { box = [1, 1, 1], cells = 1 }\nyoung = 1e5\npoisson = 0.3\ndensity = 1e3\n")
    assert simulated(other, "--resume", "--steps", "8") == 2 and "of another scene" in capsys.readouterr().err
    (out / "run.state.npz").unlink()
    assert simulated(scene(every=2), "--resume", "--steps", "8") == 2 and "to go on from" in capsys.readouterr().err


def test_tables_with_other_columns_are_not_gone_on_with(scene, tmp_path, capsys):
    """Points put in another order would be written under each other's names."""
    path = scene(every=2)
    assert simulated(path, "--no-plots", "--steps", "4") == 0
    before = rows(tmp_path / "out" / "points.csv")
    text = path.read_text()
    path.write_text(text.replace("tip =", "first = [0.1, 0.05, 0.05], tip ="))
    assert simulated(path, "--no-plots", "--resume") == 2
    assert "points.csv has other columns than this run writes" in capsys.readouterr().err
    assert rows(tmp_path / "out" / "points.csv") == before and len(read_frames(tmp_path / "out" / "run.pvd")) == 3
    path.write_text(text.replace("young = ", "young = 1"))
    assert simulated(path, "--no-plots", "--resume") == 2
    assert "numbers in the scene were changed" in capsys.readouterr().err
    path.write_text(text)
    assert simulated(path, "--no-plots", "--resume") == 0


def test_the_bar_says_compiling_and_measures_behind_it(monkeypatch, capsys):
    import time as clock

    now = [0.0]
    monkeypatch.setattr(clock, "time", lambda: now[0])
    with progress.Progress(100, shown=True) as bar:
        bar.compiling()
        assert "compiling" in capsys.readouterr().err
        now[0] = 60.0
        bar.advance(10, compiled=True)
        now[0] = 61.0
        bar.bar._time = clock.time
        bar.advance(10)
        shown = bar.bar.format_dict
        assert shown["initial"] == 10 and shown["n"] == 20 and abs(shown["elapsed"] - 1.0) < 1e-9  # 8 s left, not 244
