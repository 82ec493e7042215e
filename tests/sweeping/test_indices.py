"""Sensitivity indices against a function whose indices are known, and a sweep's against the formula of its output."""

import sys

import numpy as np
import pytest
from scenes import beam

import jaxfem as jf
from jaxfem import sweeping


def test_without_salib(monkeypatch):
    monkeypatch.setitem(sys.modules, "SALib", None)
    with pytest.raises(jf.SweepError, match=r"pip install 'jaxfem\[indices\]'"):
        sweeping.sobol({"a": (0, 1)}, 4)


def test_ishigami():
    """Ishigami & Homma 1990, a = 7, b = 0.1: shares .314, .442, 0 alone and .558, .442, .244 in all."""
    pytest.importorskip("SALib")
    variants = sweeping.sobol({name: (-np.pi, np.pi) for name in "abc"}, 2048, seed=1)
    a, b, c = variants.values()
    found = sweeping.sensitivity_indices(variants, {"y": np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)})["y"]
    for name, first, total in (("a", 0.3139, 0.5576), ("b", 0.4424, 0.4424), ("c", 0.0, 0.2437)):
        assert abs(found[name].first - first) < 0.03 and abs(found[name].total - total) < 0.03
        assert abs(found[name].first - first) < 2 * found[name].first_bar  # the interval holds it, or nearly


def test_of_a_sweep(tmp_path):
    """A frequency goes with the root of E over density; indices are those of that formula on the same variants."""
    pytest.importorskip("SALib")
    variants = sweeping.sobol({"young": (1e5, 4e5, "log"), "density": (900, 1100)}, 8)
    outputs = {"f": sweeping.outputs.Frequencies(1)}
    result = jf.sweep(*beam((2, 1, 1)), variants, dt=5e-3, steps=1, outputs=outputs)
    found = sweeping.indices_of(result)
    want = sweeping.sensitivity_indices(variants, {"f[0]": np.sqrt(variants["young"] / variants["density"])})
    np.testing.assert_allclose(list(found["f[0]"].values()), list(want["f[0]"].values()), rtol=1e-5, atol=1e-7)
    assert found["f[0]"]["young"].total > 5 * found["f[0]"]["density"].total
    x, y = result.samples("f")
    assert x.shape == (32, 2) and y.shape == (32, 1)


def test_mistakes():
    pytest.importorskip("SALib")
    variants = sweeping.sobol({"a": (0, 1), "b": (1, 2)}, 4)
    y = variants["a"] * variants["b"]
    cases = [
        (lambda: sweeping.sobol({"a": (0, 1)}, 5), "power of 2"),
        (lambda: sweeping.sensitivity_indices({n: np.roll(v, 1) for n, v in variants.items()}, {"y": y}), "sobol drew"),
        (lambda: sweeping.sensitivity_indices({n: v[:-1] for n, v in variants.items()}, {"y": y[:-1]}), "sobol drew"),
        (lambda: sweeping.sensitivity_indices(variants, {"y": 0 * y + 3}), "same for all"),
        (lambda: sweeping.sensitivity_indices(variants, {"y": y}, np.arange(16) == 3), "1 of 16 variants failed"),
    ]
    for call, message in cases:
        with pytest.raises(jf.SweepError, match=message):
            call()
