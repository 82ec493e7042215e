"""Coordinates that stand at the end of their range, cut off there or at a stop. No simulation."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import jaxfem as jf
from jaxfem.fitting import Recording
from jaxfem.fitting.before import looked_through
from jaxfem.fitting.clipped import end_faults, ends_of_range
from jaxfem.fitting.repairs import repaired

TIMES = 0.01 * np.arange(120)
PLACES = np.array([[0.1, 0, 0], [0.1, 0.03, 0.01], [0.05, 0, 0.03]])


def swing(noise=2e-5, size=0.01, middle=0.0, rate=30.0):
    """Three markers that swing along z from the 20th of 120 rows on (m)."""
    late = np.maximum(TIMES - 0.2, 0)
    places = np.tile(PLACES, (120, 1, 1)) + np.array([0, 0, middle])
    places[..., 2] -= size * (1 - np.exp(-3 * late) * np.cos(rate * late))[:, None] * [1, 0.9, 0.3]
    places += noise * np.random.default_rng(0).normal(size=places.shape)
    return Recording(TIMES, places, ("tip", "left", "middle"))


def cut_off(axis=2, sign=1, depth=0.6):
    """The same, the tip cut off at a share of its swing."""
    recording = swing()
    values = sign * recording.positions[:, 0, 2]
    limit = depth * np.abs(values - values[0]).max()
    least = sign * values[:20].mean() - limit
    cut = sign * values < least
    values[cut] = sign * least
    recording.positions[:, 0, axis] = values
    return recording


@pytest.mark.parametrize(("axis", "sign"), [(2, 1), (2, -1), (0, 1)])
@pytest.mark.parametrize("depth", [0.6, 0.8])
def test_what_is_cut_off_is_said_and_stays(axis, sign, depth):
    recording = cut_off(axis, sign, depth)
    again = repaired(recording)
    end = "smallest" if sign > 0 else "largest"
    assert any(note.startswith("tip: ") and f"{'xyz'[axis]} comes fast to its {end}" in note for note in again.notes)
    assert again.seen.all()  # a stop does the same


def test_it_is_a_fault_where_nothing_in_the_scene_stops_a_body():
    recording = cut_off()
    body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1)), 1e5, 0.3, 1e3, fixed="x-")
    for contacts, told in (([], True), ([jf.Contact(body, jf.Plane())], False)):
        model, params, _ = jf.build(jf.Scene([body], contacts=contacts))
        faults, _ = looked_through(recording, SimpleNamespace(riders=None), PLACES, model, params, "none", (0.0, 2.0))
        assert any(fault.startswith("the range: tip: ") for fault in faults) == told
        assert not told or "nothing in the scene stops it: blank the samples" in faults[0]


def digits(values, count):
    return np.vectorize(lambda value: float(f"{value:.{count}g}"))(values)


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("rate", [10.0, 30.0, 60.0])
def test_rounded_turns_are_no_ends(step, rate):
    recording = swing(rate=rate)
    rounded = dataclasses.replace(recording, positions=np.round(recording.positions / step) * step)
    assert list(ends_of_range(rounded)) == []


@pytest.mark.parametrize("count", [3, 4, 6])
@pytest.mark.parametrize("middle", [0.5, 1.0, 1.05])
def test_floating_digits_are_coarser_beyond_a_power_of_ten(count, middle):
    recording = swing(size=0.08, middle=middle, rate=15.0)
    assert list(ends_of_range(dataclasses.replace(recording, positions=digits(recording.positions, count)))) == []


def test_what_lies_with_all_else_is_no_end():
    recording = swing(0.0)
    recording.positions[:, :, 2] = np.maximum(0.05 - 4.9 * np.maximum(TIMES - 0.1, 0) ** 2, 0)[:, None]
    recording.positions[80:, :, 2] += 0.02
    assert repaired(recording).notes == ()


def test_nothing_is_lost_at_a_stop():
    """A marker that hops on a floor beside one that swings."""
    recording = swing(0.0)
    recording.positions[:, 0, 2] = np.maximum(0.1 * np.sin(3 * np.pi * TIMES), 0)
    recording.positions[:, 1, 0] += 0.02 * np.cos(9 * TIMES)
    assert repaired(recording).seen.all()


def test_few_rows_and_blank_columns():
    recording = swing()
    recording.positions[:, 1] = np.nan
    assert end_faults(recording) == []
    for rows in (2, 3, 5):
        assert (
            end_faults(dataclasses.replace(recording, times=TIMES[:rows], positions=recording.positions[:rows])) == []
        )
