"""How often is the release found?  python benchmarks/release.py [--quick] [--out FOLDER]

A soft beam is held straight, let go after some still rows and swings by 3.6 mm; five markers at 100 rows a second, one
simulation, then white noise on every coordinate, drawn anew. Of the draws: the share in which `release = "auto"` gives
the right row, one at most a row off, an interval that holds the right row, and in which it asks for the time instead.
"""

import jax
import numpy as np
from machine import describe
from report import arguments, finish, save

jax.config.update("jax_enable_x64", True)

import jaxfem as jf  # noqa: E402
from jaxfem.fitting import attach, marker_positions  # noqa: E402
from jaxfem.fitting.release import find_release  # noqa: E402

DT = 1e-2
NOISES = (0.0, 2e-5, 5e-5, 1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3)  # m
PLACES = {
    "tip": (0.1, 0.015, 0.036),
    "left": (0.1, -0.006, 0.024),
    "right": (0.1, 0.036, 0.006),
    "middle": (0.05, 0.015, 0.036),
    "side": (0.02, 0.036, 0.015),
}


def motion(substeps):
    """Places of the markers (T, M, 3) from the release on; with few steps a row the first displacement is too great."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells=(4, 2, 2))
    body = jf.SoftBody(mesh, 2.6e5, 0.4, 1070.0, damping=2e-3, fixed="x-")
    model, params, state = jf.build(jf.Scene([body]))
    markers = attach(model, PLACES)
    states, _ = jf.rollout(model, params, state, DT / substeps, 60 * substeps, every=substeps)
    first = marker_positions(markers, state.positions)[None]
    return np.concatenate([first, marker_positions(markers, states.positions)])


def shares(paths, still, noise, draws):
    held = np.concatenate([np.repeat(paths[:1], still, axis=0), paths])
    counts = {"right": 0, "within_a_row": 0, "interval_holds_it": 0, "asked_for": 0}
    widths = []
    for seed in range(draws):
        places = held + noise * np.random.default_rng(seed).normal(size=held.shape)
        try:
            found = find_release(jf.Recording(DT * np.arange(len(held)), places, tuple(PLACES)))
        except jf.FitError:
            counts["asked_for"] += 1
            continue
        counts["interval_holds_it"] += found.low <= still <= found.high
        if found.vague:
            counts["asked_for"] += 1
            continue
        widths.append(found.high - found.low)
        counts["right"] += found.row == still
        counts["within_a_row"] += abs(found.row - still) <= 1
    return {key: value / draws for key, value in counts.items()} | {
        "median_width_rows": float(np.median(widths)) if widths else None
    }


def main():
    options = arguments(__doc__)
    draws = 30 if options.quick else 300
    figures = {"machine": describe(), "draws": draws}
    for substeps in (1, 8):
        paths = motion(substeps)
        for still in (20, 2, 0):
            for noise in NOISES:
                key = f"substeps_{substeps}_still_{still}_noise_{1e3 * noise:g}_mm"
                figures[key] = shares(paths, still, noise, draws)
                print(key, figures[key], flush=True)
                save("release", figures, options.out)
    finish("release", figures, options.out)


if __name__ == "__main__":
    main()
