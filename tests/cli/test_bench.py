"""`jaxfem bench`: what it prints and leaves, on its small scene."""

import csv
import json

import pytest

from jaxfem.cli import bench
from jaxfem.cli.main import main
from jaxfem.cli.measuring import QUICK, TOLERANCES, count_rows


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    assert main(["bench", "--quick", "--out", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_every_tolerance_is_measured_and_the_error_follows_it(folder):
    found = json.loads((folder / "bench.json").read_text())
    rows = found["rows"]
    assert "JAX" in found["machine"]
    assert [(row["precision"], row["tolerance"]) for row in rows] == [(p, t) for p in TOLERANCES for t in TOLERANCES[p]]
    double = [row for row in rows if row["precision"] == "float64"]
    assert double[-1]["error"] < 1e-5 < double[0]["error"] and double[-1]["iterations"] > double[0]["iterations"]
    for row in rows:
        assert row["status"] == 0 and row["ms_per_step"] * row["steps_per_second"] == pytest.approx(1e3)
        assert (row["compile_s"] is not None) == (row["tolerance"] == 1e-4) == (row["gradient_ratio"] is not None)


@pytest.mark.slow
def test_the_table_and_plot_say_the_same(folder):
    with (folder / "bench.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8 and rows[0]["scene"] == QUICK[0].name and float(rows[2]["memory_mb"]) > 0
    assert (folder / "time_against_error.png").read_bytes()[:4] == b"\x89PNG"
    assert count_rows(QUICK) == 11


def test_a_failed_solve_is_told(tmp_path, monkeypatch, capsys):
    row = bench.Row("beam", 96, "float32", 1e-3, 5.0, 1.0, 1e3, 0.5, 1)
    monkeypatch.setattr(bench, "measure", lambda *_: [row])
    assert main(["bench", "--quick", "--out", str(tmp_path)]) == 3
    said = capsys.readouterr()
    assert "beam, float32, tolerance 0.001: a solve did not converge" in said.err
    assert said.out.splitlines()[1].split() == "beam 96 float32 1e-03 5.0 1 1000 5.0e-01".split()
