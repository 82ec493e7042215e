"""The real beam with its hanging weight as a body on a string.  python benchmarks/real_beam_weight.py DIR [--quick]

DIR as for real_beam.py. E and damping come from gravity.csv alone (--young and --damping: from there). The weight is a
rigid ball on a rope from the middle of the tip's upper edge, 0.1 m below; beam and ball start at rest, straight and
hanging, and are let go. Compared: the frequency of the ringing (a damped cosine through the tip markers' mean height,
measured and computed alike) and the settled height. Backward Euler, 1 ms (its own damping: ratio 0.01 at 3 Hz).
The damping ratio again once the hand is away, without and with dry friction in the cosine, by which an amplitude also
falls by a constant each half cycle: what is computed has none, so there it must come out as about zero.
"""

import argparse
import pathlib
from typing import NamedTuple

import jax
import numpy as np
from machine import describe
from real_beam import PLACES, SETTLED, TIPS, fitted, recording_of, weight_of
from real_beam import beam as bare_beam
from report import finish
from scipy.optimize import curve_fit

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402
from jaxfem.fitting.markers import attach, marker_positions  # noqa: E402
from jaxfem.fitting.measurement import measurement  # noqa: E402

STRING, GRAVITY, DT, TIME = 0.1, 9.81, 1e-3, 1.5
EDGE = (0.0, 0.015, 0.03)
CLEAR = 0.08  # s after the release: the hand lets go over two or three samples, and more than one mode rings first


def hanging(cells, material, force):
    """(model, params, state) of the beam with the ball."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=12, origin=(-0.1, 0.0, 0.0))
    body = jf.SoftBody(mesh, density=1070.0, material=material, fixed="x-", strain="smoothed", name="beam")
    place = (EDGE[0], EDGE[1], EDGE[2] - STRING)
    ball = jf.RigidBody(jf.Sphere(0.015), mass=force / GRAVITY, position=place, name="weight")
    rope = jf.DistanceJoint(body, ball, EDGE, place, length=STRING, rope=True)
    return jf.build(jf.Scene([body, ball], gravity=(0, 0, -GRAVITY), joints=[rope]), tolerance=1e-6)


class Ringing(NamedTuple):
    """A damped cosine through heights: frequency [Hz], damping ratio, settled height [m], fall of the amplitude by dry
    friction in half a cycle [m], and the rms that it leaves [m]."""

    frequency: float
    ratio: float
    settled: float
    dry: float
    left: float


def ringing(times, heights, dry=False):
    """The `Ringing` that fits best, with or without `dry` friction."""
    seen = np.isfinite(heights)
    times, heights = times[seen], heights[seen]
    settled = heights[-len(heights) // 4 :].mean()

    def model(t, rest, size, decay, omega, phase, fall=0.0):
        # d|a|/dt = -decay |a| - fall, until nothing is left
        large = np.abs(size) * np.exp(-decay * t) + fall / decay * np.expm1(-decay * t)
        return rest + np.sign(size) * np.maximum(large, 0) * np.cos(omega * t + phase)

    best = None
    for frequency in np.arange(2.0, 8.0, 0.5):
        start = (settled, heights[0] - settled, 1.0, 2 * np.pi * frequency, 0.0, *([1e-4] if dry else []))
        try:
            found, _ = curve_fit(model, times, heights, start, maxfev=4000)
        except RuntimeError:
            continue
        miss = np.sum((model(times, *found) - heights) ** 2)
        if best is None or miss < best[0]:
            best = miss, found
    rest, _, decay, omega, _, *fall = best[1]
    omega, left = abs(omega), float(np.sqrt(best[0] / len(times)))
    lost = float(fall[0]) * np.pi / omega if dry else 0.0
    return Ringing(omega / (2 * np.pi), decay / np.hypot(decay, omega), rest, lost, left)


def clear(computed, measured, dry):
    """Damping ratios, falls by dry friction [mm] and misfits [mm], computed and measured, once the hand is away."""
    own, real = (ringing(times[times > CLEAR], heights[times > CLEAR], dry) for times, heights in (computed, measured))
    return {
        "damping_ratio": own.ratio,
        "measured_damping_ratio": real.ratio,
        "fall_mm": [1e3 * own.dry, 1e3 * real.dry],
        "left_mm": [1e3 * own.left, 1e3 * real.left],
    }


def compare(folder, name, cells, material):
    """Figures of one take with a beam of this material."""
    model, params, state = hanging(cells, material, weight_of(name))
    markers = attach(model, PLACES)
    start = np.asarray(marker_positions(markers, state.positions))
    taken = measurement(
        recording_of(folder, name).subset(markers.names),
        start,
        frame="rest",
        compare="displacement",
        release="auto",
        end=None,
    )
    seen = np.where(taken.seen[..., None], taken.positions, np.nan) - taken.origin
    measured = np.nanmean(seen[:, TIPS, 2], axis=1)
    part = taken.times <= TIME
    steps, every = round(TIME / DT), 10
    states, info = jf.rollout(model, params, state, DT, steps, every=every)
    moved = jax.vmap(lambda x: marker_positions(markers, x))(states.positions) - start
    height = np.asarray(jnp.mean(moved[:, np.array(TIPS), 2], axis=1))
    computed = DT * every * np.arange(1, len(height) + 1), height
    taken_part = taken.times[part], measured[part]
    own, real = (ringing(*each) for each in (computed, taken_part))
    settled = float(np.nanmedian(measured[-SETTLED:]))
    return {
        "frequency_hz": own.frequency,
        "measured_hz": real.frequency,
        "frequency_error": own.frequency / real.frequency - 1,
        "damping_ratio": own.ratio,
        "measured_damping_ratio": real.ratio,
        "from_clear": clear(computed, taken_part, False),
        "from_clear_beside_dry_friction": clear(computed, taken_part, True),
        "settled_mm": 1e3 * own.settled,
        "measured_settled_mm": 1e3 * settled,
        "settled_error": own.settled / settled - 1,
        "status": int(info.status.max()),
        "iterations": int(info.iterations.max()),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=pathlib.Path, help="folder with gravity.csv and loadNN.csv")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh")
    parser.add_argument("--young", type=float, help="Young's modulus [Pa] (fitted on gravity.csv)")
    parser.add_argument("--damping", type=float, help="damping [s] (fitted on gravity.csv)")
    parser.add_argument("--out", type=pathlib.Path, help="folder for real_beam_weight.json")
    chosen = parser.parse_args()
    cells = (6, 2, 2) if chosen.quick else (10, 3, 3)
    young, damping = chosen.young, chosen.damping
    if young is None or damping is None:
        values = fitted(bare_beam(cells), recording_of(chosen.folder, "gravity"), 1e-2).values
        young, damping = float(values["young"]), float(values["damping"])
    takes = sorted(path.stem for path in chosen.folder.glob("load*.csv") if weight_of(path.stem) is not None)
    figures = {"machine": describe(), "cells": cells, "young": young, "damping": damping, "dt": DT}
    figures |= {name: compare(chosen.folder, name, cells, jf.Linear(young, 0.499, damping)) for name in takes}
    finish("real_beam_weight", figures, chosen.out)


if __name__ == "__main__":
    main()
