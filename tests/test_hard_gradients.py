"""benchmarks/hard_gradients.py: how a line is judged, its quickest case, and the page's table."""

import json
import pathlib
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "benchmarks"))  # behind: both have a `scenes`

import hard_gradients  # noqa: E402
from hard.gradient_cases import CASES  # noqa: E402

LINE = {"above": 1.0, "below": 1.0, "off": 1e-9, "reverse_off": 1e-9, "spread": 1e-9, "status": [0]}
LINE |= {"weakly_active": 0, "derivative": 1.0, "residual": 1e-12, "tolerance": 1e-13}


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({}, "right"),
        ({"off": 1e-3}, "SILENT"),
        ({"reverse_off": 1e-3}, "SILENT"),
        ({"off": 1e-5, "spread": 1e-5}, "as near as differences settle"),
        ({"below": 0.0}, "SILENT: other from above than from below"),
        ({"below": 0.0, "weakly_active": 2}, "flagged: info.weakly_active = 2"),
        ({"off": 1e-3, "status": [0, 7]}, "flagged: status 7"),
        ({"off": 1.0, "spread": 0.5, "residual": 1e-9}, "flagged: info.residual = 1e-09 where 1e-13 was asked"),
        ({"off": 1.0, "spread": 1e-9, "residual": 1e-9}, "SILENT"),
        ({"off": 1.0, "below": 0.5, "spread": 0.5}, "forwards as backwards; differences do not settle"),
        ({"off": 3.0, "spread": 0.5, "reverse_off": 0.1}, "SILENT"),
    ],
)
def test_how_a_line_is_judged(change, outcome):
    assert hard_gradients.outcome(LINE | change) == outcome


@pytest.mark.slow
def test_where_there_is_no_derivative_it_is_flagged():
    line = hard_gradients.measured(CASES["laid on the ground without weight"][1]())
    assert line["outcome"].startswith("flagged: info.weakly_active")
    assert line["above"] == pytest.approx(1 / 30) and abs(line["below"]) < 1e-6


@pytest.mark.slow
def test_stacked_boxes_that_come_to_a_stop_have_the_same_derivative_backwards():
    """Sixteen corners share what three would carry: a residual of 1e-7 was taken for a solution there."""
    line = hard_gradients.measured(CASES["stacked boxes"][1]())
    assert line["outcome"] == "right" and line["reverse_off"] < 1e-8


def test_the_page_shows_what_was_measured():
    page = (ROOT / "docs" / "derivatives.md").read_text(encoding="utf-8")
    for line in json.loads((ROOT / "benchmarks" / "results" / "hard_gradients.json").read_text())["lines"]:
        assert f"| {line['case']} | {line['derivative_of']} | {line['derivative']:.6g} |" in page
