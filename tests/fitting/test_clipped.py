"""Coordinates that are cut off at the end of a range. No simulation."""

import dataclasses

import numpy as np
import pytest

from jaxfem.fitting import Recording
from jaxfem.fitting.repairs import repaired


def swing(noise=2e-5):
    """Three markers that swing along z from the 20th of 120 rows on (m)."""
    times = 0.01 * np.arange(120)
    late = np.maximum(times - 0.2, 0)
    places = np.tile(np.array([[0.1, 0, 0], [0.1, 0.03, 0.01], [0.05, 0, 0.03]]), (120, 1, 1))
    places[..., 2] -= 0.01 * (1 - np.exp(-3 * late) * np.cos(30 * late))[:, None] * [1, 0.9, 0.3]
    places += noise * np.random.default_rng(0).normal(size=places.shape)
    return Recording(times, places, ("tip", "left", "middle"))


@pytest.mark.parametrize(("axis", "sign"), [(2, 1), (2, -1), (0, 1)])
@pytest.mark.parametrize("depth", [0.6, 0.8])
def test_what_is_cut_off_is_missing_and_said(axis, sign, depth):
    recording = swing()
    places = recording.positions
    places[:, 0, axis] = sign * (recording.positions[:, 0, 2])
    limit = depth * np.abs(places[:, 0, axis] - places[0, 0, axis]).max()
    values = sign * places[:, 0, axis]
    cut = values < (least := values[:20].mean() - limit)
    places[cut, 0, axis] = sign * least
    again = repaired(recording)
    lost = ~again.seen[:, 0]
    assert lost[cut].mean() > 0.7 and not lost[~cut].any() and again.seen[:, 1:].all()
    end = "smallest" if sign > 0 else "largest"
    assert any(
        f"tip: {lost.sum()} samples" in note and f"{'xyz'[axis]} stands at its {end}" in note for note in again.notes
    )


@pytest.mark.parametrize("digit", [1e-3, 1e-4, 1e-5])
def test_rounded_turns_are_no_ends(digit):
    recording = swing()
    rounded = dataclasses.replace(recording, positions=np.round(recording.positions / digit) * digit)
    assert repaired(rounded).notes == ()


def test_what_lies_on_something_is_no_end():
    recording = swing(0.0)
    recording.positions[:, :, 2] = np.maximum(0.05 - 4.9 * np.maximum(recording.times - 0.1, 0) ** 2, 0)[:, None]
    recording.positions[80:, :, 2] += 0.02
    assert repaired(recording).notes == ()
