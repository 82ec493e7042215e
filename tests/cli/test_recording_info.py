"""`jaxfem recording info`: what is in a recording, and what is wrong with it."""

import numpy as np

from jaxfem.cli.main import main
from jaxfem.fitting import Recording, write_recording


def swing():
    t = np.maximum(np.arange(150) - 40, 0) * 0.01
    places = np.zeros((150, 2, 3)) + np.array([[0.1, 0.01, 0.03], [0.05, 0.01, 0.03]])
    places[..., 2] -= 1e-2 * (1 - np.exp(-4 * t) * np.cos(50 * t))[:, None] * [1, 0.3]
    return places + 2e-5 * np.random.default_rng(0).normal(size=places.shape)


def said(folder, capsys, times, places):
    write_recording(folder / "r.csv", Recording(times, places, ("tip", "mid")))
    assert main(["recording", "info", str(folder / "r.csv")]) == 0
    return capsys.readouterr().out


def test_what_it_is_is_told(tmp_path, capsys):
    out = said(tmp_path, capsys, np.arange(150) * 0.01, swing())
    for part in ("plain table: 2 markers, 150 rows", "unit: m", "rate: 100 rows", "tip: first at", "no gaps"):
        assert part in out
    assert "still until 0.4 s; settled from" in out and "note" not in out


def test_gaps_codes_and_clocks_are_told(tmp_path, capsys):
    places = swing()
    places[60:63, 0] = np.nan
    places[80, 1] = 0.0
    times = np.arange(150) * 1.0
    times[100:] += 30
    out = said(tmp_path, capsys, times, places)
    for part in (
        "3 samples missing in 1 gaps",
        "0 stands for a lost sample",
        "pause: no samples for 31 s",
        "whole numbers",
    ):
        assert part in out


def test_a_file_in_mm_with_a_rate(tmp_path, capsys):
    rows = "".join(f"{k},{100 - 0.1 * k},15,30\n" for k in range(5))
    (tmp_path / "r.csv").write_text("frame,tip_x,tip_y,tip_z\n" + rows)
    assert main(["recording", "info", str(tmp_path / "r.csv")]) == 2
    assert "says no unit" in capsys.readouterr().err
    assert main(["recording", "info", str(tmp_path / "r.csv"), "--unit", "mm", "--rate", "100"]) == 0
    assert "unit: mm, taken to m" in capsys.readouterr().out
