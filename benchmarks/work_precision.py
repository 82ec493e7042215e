"""Work against error: what does an accurate answer cost?  python benchmarks/work_precision.py [--quick] [--out FOLDER]

Beam of 0.1 x 0.03 x 0.03 m, E = 264 kPa, nu 0.45, clamped, under a hundredth of its weight (linear regime). Error: mean
sag of the free end face against locking-free quadratic elements (6.875 mm at full weight). Time: one static solve from
the undeformed shape, and one of 20 time steps of 10 ms, each to 1e-6 (float32: 1e-5). All kinds of strain rows, meshes
of 6 and 12 tetrahedra a cell, both precisions; medians of 3, single runs on the two finest meshes.
`plain_over_smoothed`: time of plain rows over that of smoothed ones at 2 % error, on each kind's front of the fastest
for an error; where the finest plain mesh is less accurate, by extrapolation of its two finest points on the front, and
`plain_finest_over_smoothed` is what was measured at least.
"""

import csv
import itertools
import math
import warnings

import jax
import numpy as np
from machine import describe, median_time
from report import arguments, finish, save

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402

SAG, SHARE, POISSON, DT, STEPS, TARGET = 6.875e-3, 1e-2, 0.45, 1e-2, 20, 0.02
STRAINS = ("element", "nodal_volume", "smoothed")
MESHES = [((c * 10 // 3, c, c), tets) for c in (3, 6, 9, 12) for tets in (6, 12)]
TOLERANCES = {"float64": 1e-6, "float32": 1e-5}


def measure(strain, cells, tets_per_cell, precision, repeats):
    """One row of the table."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=tets_per_cell)
    body = jf.SoftBody(mesh, 263824.0, POISSON, 1070.0, damping=2e-3, fixed="x-", strain=strain)
    scene = jf.Scene([body], gravity=(0.0, 0.0, -9.80709 * SHARE))
    model, params, state = jf.build(scene, dtype=getattr(jnp, precision), tolerance=TOLERANCES[precision])
    static_s = median_time(lambda: jf.equilibrium(model, params, state), repeats)
    run_s = median_time(lambda: jf.rollout(model, params, state, DT, STEPS, every=STEPS), repeats)
    rest, info = jf.equilibrium(model, params, state)
    _, stepping = jf.rollout(model, params, state, DT, STEPS, every=STEPS)
    tip = np.asarray(model.rest)[:, 0] > 0.1 - 1e-6
    sag = float(-np.mean(np.asarray(rest.positions - model.rest)[tip, 2])) / SHARE
    return {
        "strain": strain,
        "cells": "x".join(map(str, cells)),
        "tets": model.elements.count,
        "precision": precision,
        "sag_mm": 1e3 * sag,
        "error": abs(sag / SAG - 1),
        "static_ms": 1e3 * static_s,
        "step_ms": 1e3 * run_s / STEPS,
        "step_iterations": int(stepping.iterations.max()),
        "status": max(int(info.status), int(stepping.status.max())),
    }


def front(rows, what):
    """(error, time) of the rows that no other beats in both, from coarse to fine."""
    points = sorted((r[what], r["error"]) for r in rows if r["status"] == 0)
    best, kept = math.inf, []
    for seconds, error in points:
        if error < best:
            best = error
            kept.append((error, seconds))
    return kept


def time_at(points, target):
    """Time at an error by straight lines between logarithms; (time, whether it is measured and not extrapolated)."""
    if points[0][0] <= target:
        return points[0][1], True
    if len(points) == 1:
        return math.nan, False
    inside = points[-1][0] <= target
    if inside:
        after = next(i for i, (error, _) in enumerate(points) if error <= target)
    else:
        after = len(points) - 1
    (e0, t0), (e1, t1) = points[after - 1], points[after]
    slope = math.log(t1 / t0) / math.log(e1 / e0)
    return t1 * math.exp(slope * math.log(target / e1)), inside


def select(rows, strain, precision):
    """The rows of one kind and precision."""
    return [r for r in rows if (r["strain"], r["precision"]) == (strain, precision)]


def compare(rows):
    """Times at the target error for each strain, precision and kind of solve, and the ratio asked for."""
    found = {}
    for precision in sorted({r["precision"] for r in rows}):
        for what in ("static_ms", "step_ms"):
            fronts = {
                s: front([r for r in rows if (r["strain"], r["precision"]) == (s, precision)], what) for s in STRAINS
            }
            times = {s: time_at(points, TARGET) for s, points in fronts.items() if points}
            entry = {f"{s}_ms": t for s, (t, _) in times.items()}
            entry["extrapolated"] = [s for s, (_, measured) in times.items() if not measured]
            if {"element", "smoothed"} <= times.keys():
                entry["plain_over_smoothed"] = times["element"][0] / times["smoothed"][0]
                entry["plain_finest_over_smoothed"] = fronts["element"][-1][1] / times["smoothed"][0]
            found[f"{precision}_{what.removesuffix('_ms')}"] = entry
    return found


def plot(rows, machine, path):
    """Error against time, one panel for statics and one for a step."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.5), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2, sharey=True)
    colours = dict(zip(STRAINS, ("tab:red", "tab:orange", "tab:blue"), strict=True))
    for axis, what, title in zip(axes, ("static_ms", "step_ms"), ("static solve", "time step, 10 ms"), strict=True):
        for strain in STRAINS:
            for precision, line, marker in (("float32", ":", "o"), ("float64", "-", "s")):
                own = select(rows, strain, precision)
                if not own:
                    continue
                points = front(own, what)
                label = f"{strain}, {precision}"
                axis.loglog([r[what] for r in own], [r["error"] for r in own], marker, color=colours[strain], alpha=0.4)
                axis.loglog([t for _, t in points], [e for e, _ in points], line, color=colours[strain], label=label)
        axis.axhline(TARGET, color="grey", linewidth=0.8)
        axis.set(title=title, xlabel="time (ms)")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(f"error of the sag, nu = {POISSON}")
    axes[1].legend(fontsize=8)
    figure.suptitle(machine, fontsize=8)
    figure.savefig(path)


def main():
    options = arguments(__doc__)
    warnings.simplefilter("ignore", jf.AccuracyWarning)
    meshes, precisions, repeats = (MESHES[1:4:2], ["float64"], 1) if options.quick else (MESHES, TOLERANCES, 3)
    machine, rows = describe(), []
    for precision, (cells, tets), strain in itertools.product(precisions, meshes, STRAINS):
        rows.append(measure(strain, cells, tets, precision, 1 if max(cells) > 20 else repeats))
        jax.clear_caches()  # 48 programs and their meshes would fill the memory
        save("work_precision", {"machine": machine, "rows": rows}, options.out)
    figures = {"machine": machine, "at_2_percent": compare(rows), "rows": rows}
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        with (options.out / "work_precision.csv").open("w", newline="") as file:
            table = csv.DictWriter(file, rows[0].keys())
            table.writeheader()
            table.writerows(rows)
        plot(rows, machine, options.out / "work_precision.png")
    finish("work_precision", figures, options.out)


if __name__ == "__main__":
    main()
