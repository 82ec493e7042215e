"""What a sweep does on an accelerator, as far as a processor can tell: the engine, its width, lanes without fences."""

import types

import numpy as np
from scenes import beam

import jaxfem as jf
from jaxfem import sweeping
from jaxfem.sweeping.chunks import chosen


def test_accelerators_take_lanes_without_fences(monkeypatch):
    """Wide chunks, and the same answers: in single precision to some of its digits, of what moves by a hundredth of its
    size."""
    away = [types.SimpleNamespace(platform="gpu")]
    made = sweeping.Sweep(*beam((2, 1, 1)), {"young": [1e5]}, dt=5e-3, steps=1, outputs={"e": "energies"})
    engine, reason = chosen(made.task, "auto", away)
    assert engine.name == "lanes" and reason == "soft bodies"
    assert engine.widest(made.task, "gpu") > 1000 and engine.widest(made.task, "cpu") == 32
    smoothed = sweeping.Sweep(
        *beam((2, 1, 1), strain="smoothed"), {"young": [1e5]}, dt=5e-3, steps=1, outputs={"e": "energies"}
    )
    assert chosen(smoothed.task, "auto", away)[0].name == "vmap"
    monkeypatch.setattr("jaxfem.sweeping.lanes.body._on_cpu", lambda model: False)
    options = {"dt": 5e-3, "steps": 10, "every": 5, "outputs": {"x": "positions"}}
    exact = jf.sweep(*beam((2, 1, 1)), {"young": [1e5, 1e6]}, engine="loop", **options)
    found = jf.sweep(*beam((2, 1, 1), build={"dtype": "float32"}), {"young": [1e5, 1e6]}, engine="lanes", **options)
    moved = np.abs(exact["x"] - np.asarray(made.task.model.rest)).max((1, 2, 3))
    assert found.good.all() and moved[1] < 1e-3
    assert (np.abs(found["x"] - exact["x"]).max((1, 2, 3)) / moved).max() < 1e-4
