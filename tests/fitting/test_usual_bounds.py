"""Bounds of a fit where a user gives none: about the start, and within what a constant may be."""

import pytest

from jaxfem.fitting.unknowns import unknowns
from jaxfem.materials.constants import Constant, Identity


@pytest.mark.parametrize(
    ("limits", "start", "expected"),
    [
        ({"low": 0.0}, 2.0, (2e-3, 2e3)),
        ({"low": 0.0, "high": 1.0}, 0.5, (5e-4, 0.9995)),
        ({"low": 10.0}, 20.0, (10.01, 2e4)),
        ({"low": -1.0, "high": 1.0, "transform": Identity()}, 0.2, (-0.9988, 0.9992)),
        ({"transform": Identity()}, -3.0, (-3003.0, 2997.0)),
    ],
)
def test_they_hold_the_start_and_nothing_inadmissible(limits, start, expected):
    constant = Constant("c", "", "must be what it is", **limits)
    found = unknowns([constant], {"c": start}, None, 1e-2)
    low, high = (float(end[0]) for end in (found.lower, found.upper))
    assert low < start < high
    assert (low, high) == pytest.approx(expected, rel=1e-9)
