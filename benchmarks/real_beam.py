"""The real beam: E and damping from one recording, the others predicted.  python benchmarks/real_beam.py DIR [--quick]

DIR holds gravity.csv and any loadNN.csv: motion capture of a clamped silicone beam let go under its own weight, and
under a hanging weight of NN grams at the tip's upper edge (Dubied, Michelis, Spielberg & Katzschmann 2022). Poisson's
ratio is held at 0.499. The release is found in the data and fitted. Of the loaded takes the settled shape is predicted,
with the weight as a force. --quick: a coarse mesh and one fit; without it also other steps, nu fitted, all takes
together, and plain rows with backward Euler. --branches 1 2: laws that relax instead (real_beam_branches.py).
"""

import argparse
import pathlib
import re
import sys

import jax
import numpy as np
from machine import describe
from report import finish, save

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402

import jaxfem as jf  # noqa: E402
from jaxfem.fitting.markers import attach, marker_positions  # noqa: E402
from jaxfem.fitting.measurement import measurement  # noqa: E402
from jaxfem.fitting.search import Search  # noqa: E402

PLACES = {
    "tip_1": (0.0, 0.015, 0.036),
    "tip_2": (0.0, -0.006, 0.024),
    "tip_3": (0.0, 0.036, 0.006),
    "base_1": (-0.094, -0.01, -0.001),
    "base_2": (-0.094, 0.04, 0.0275),
    "base_3": (-0.094, 0.04, 0.0),
}
TIPS = [name.startswith("tip") for name in PLACES]
WEIGHTS = {"load52": 0.51012, "load101": 1.00062}  # N, as published; other takes: from the grams NN in loadNN
SETTLED = 50  # samples at the end of a take that count as settled


def beam(cells, poisson=0.499, strain="smoothed", scheme="generalized_alpha", force=0.0, material=None):
    """(model, params, state) of the straight beam, `force` [N] hanging from the tip's upper edge."""
    mesh = jf.mesh.box((0.1, 0.03, 0.03), cells, tets_per_cell=12, origin=(-0.1, 0.0, 0.0))
    edge = np.flatnonzero((np.abs(mesh.points[:, 0]) < 1e-9) & (mesh.points[:, 2] > 0.03 - 1e-9))
    share = np.full(len(edge), 1.0)
    share[[mesh.points[edge, 1].argmin(), mesh.points[edge, 1].argmax()]] = 0.5
    pull = -force * (share / share.sum())[:, None] * np.array([0.0, 0.0, 1.0])
    load = jf.NodalForce(edge, pull)
    material = material or jf.Linear(2.6e5, poisson, 2.5e-3)
    body = jf.SoftBody(mesh, density=1070.0, material=material, fixed="x-", strain=strain, loads=[load], name="beam")
    return jf.build(jf.Scene([body], gravity=(0, 0, -9.81)), scheme=scheme, tolerance=1e-6)


def recording_of(folder, name):
    return jf.read_recording(folder / f"{name}.csv")


def fitted(scene, recording, dt, parameters=("young", "damping", "delay"), near=None):
    """A fit from afar, or near known values (then without a wide search)."""
    model, params, state = scene
    bounds = None
    if near is not None:
        params = params.replace(young=near["young"], damping=near["damping"])
        bounds = {"young": (0.75 * near["young"], 1.3 * near["young"])}
    search = Search(candidates=1, polish=10, tol=1e-4)
    options = {"frame": "rest", "end": "settled", "search": search, "bounds": bounds}
    return jf.fit(model, params, state, recording, PLACES, parameters=parameters, dt=dt, **options)


def summary_of(result):
    """Values with error bars and the misfit of the tip markers in mm: all directions, a coordinate, vertical."""
    tips = result.residuals[:, [name.startswith("tip") for name in result.markers]]
    values = {name: float(value) for name, value in result.values.items()}
    errors = {f"{name}_error": float(value) for name, value in result.standard_errors.items()}
    return {
        **values,
        **errors,
        "rms_mm": 1e3 * float(np.sqrt(np.nanmean(tips**2))),
        "rms_vertical_mm": 1e3 * float(np.sqrt(np.nanmean(tips[..., 2] ** 2))),
        "rms_distance_mm": 1e3 * float(np.sqrt(np.nanmean(np.sum(tips**2, axis=-1)))),
        "release_time": result.release + values.get("delay", 0.0),
    }


def weight_of(name):
    """Hanging weight [N] of a take "loadNN...", from its grams NN; None for other names."""
    found = re.match(r"load(\d+)", name)
    return None if found is None else WEIGHTS.get(found[0], 9.81e-3 * float(found[1]))


class Settled:
    """Settled heights of a take's tip markers, measured and computed."""

    def __init__(self, folder, name, cells):
        self.force = 0.0 if name == "gravity" else weight_of(name)
        self.model, self.params, self.state = beam(cells, force=self.force)
        self.markers = attach(self.model, PLACES)
        start = np.asarray(marker_positions(self.markers, self.state.positions))
        recording = recording_of(folder, name).subset(self.markers.names)
        taken = measurement(recording, start, frame="rest", compare="displacement", release="auto", end=None)
        last = np.where(taken.seen[..., None], taken.positions, np.nan)[-SETTLED:]
        self.measured = float(np.nanmean((np.nanmedian(last, axis=0) - taken.origin)[TIPS, 2]))

    def computed(self, young):
        """Mean height of the tip markers above their start [m], and its derivative in Young's modulus."""
        scene = self.model, self.params, self.state, self.markers
        (value, status), slope = rest_height(jnp.asarray(young), *scene)
        if int(status):
            raise SystemExit(f"no equilibrium at E = {young:g} Pa: {jf.solvers.describe(status)}")
        return float(value), float(slope)


@jax.jit  # one program for all takes: they differ in arrays only
def rest_height(young, model, params, state, markers):
    """((mean height of the tip markers at rest above their start [m], status), derivative in Young's modulus)."""

    def height(value):
        rest, info = jf.equilibrium(model, params.replace(young=value), state)
        moved = marker_positions(markers, rest.positions) - marker_positions(markers, state.positions)
        return jnp.mean(moved[np.array(TIPS), 2]), info.status

    return jax.value_and_grad(height, has_aux=True)(young)


def settled_young(takes, young):
    """Young's modulus from settled heights alone: least squares of the relative misfit, by Gauss-Newton."""
    for _ in range(8):
        pairs = [(take.computed(young), take.measured) for take in takes]
        r = np.array([value / measured - 1 for (value, _), measured in pairs])
        slope = np.array([own / measured for (_, own), measured in pairs])
        change = -float(r @ slope / (slope @ slope))
        young += change
        if abs(change) < 1e-5 * young:
            break
    return young


def heights(takes, young):
    """Predicted and measured settled heights [mm] and their relative difference, by take."""
    out = {}
    for name, take in takes.items():
        value = take.computed(young)[0]
        error = value / take.measured - 1
        out[name] = {"predicted_mm": 1e3 * value, "measured_mm": 1e3 * take.measured, "error": error}
    return out


def more(cells, gravity, near):
    """What else there is to ask of one take: other steps, nu fitted, plain rows with backward Euler; one by one."""
    nu = ("young", "poisson", "damping", "delay")
    yield "dt_5ms", fitted(beam(cells), gravity, 5e-3, near=near)
    yield "with_poisson", fitted(beam(cells, 0.48), gravity, 1e-2, nu, near)
    yield "plain_backward_euler", fitted(beam(cells, strain="element", scheme="backward_euler"), gravity, 1e-2)
    yield "dt_2.5ms", fitted(beam(cells), gravity, 2.5e-3, near=near)


def draw(path, results):
    """Vertical motion of the tip markers, measured and fitted, a panel for each fit by name."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5 * len(results), 4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(results), sharey=True, squeeze=False)[0]
    for axes, (title, result) in zip(panels, results.items(), strict=True):
        for marker, name in enumerate(result.markers):
            if name.startswith("tip"):
                start = result.measured[0, marker, 2]
                (line,) = axes.plot(
                    result.times, 1e3 * (result.simulated[:, marker, 2] - start), label=f"{name}, fitted"
                )
                seen = 1e3 * (result.measured[:, marker, 2] - start)
                axes.plot(result.times, seen, ".", ms=3, color=line.get_color())
        young, damping = 1e-3 * float(result.values["young"]), 1e3 * float(result.values["damping"])
        axes.set_title(f"{title}: E = {young:.0f} kPa, beta = {damping:.2f} ms", fontsize=10)
        axes.set_xlabel("time since the release, s")
    panels[0].set_ylabel("height above the first sample, mm")
    panels[0].legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def takes_in(folder, cells):
    """Name -> settled shape of each take in the folder."""
    names = ["gravity", *sorted(path.stem for path in folder.glob("load*.csv") if weight_of(path.stem) is not None)]
    for other in sorted({path.stem for path in folder.glob("*.csv")} - set(names)):
        print(f"left out: {other}.csv (takes are gravity.csv and loadNN.csv)", file=sys.stderr)
    return {name: Settled(folder, name, cells) for name in names}


def branches(chosen, cells):
    """Laws that relax, one after the other."""
    from real_beam_branches import run

    figures, takes = {"machine": describe(), "cells": cells}, takes_in(chosen.folder, cells)
    for count in chosen.branches:
        figures[f"{count} branches"] = run(chosen.folder, cells, count, takes)
        save("real_beam_branches", figures, chosen.out)
    finish("real_beam_branches", figures, chosen.out)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=pathlib.Path, help="folder with gravity.csv and loadNN.csv")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh and one fit")
    parser.add_argument("--branches", type=int, nargs="+", default=[], help="laws with so many branches that relax")
    parser.add_argument("--out", type=pathlib.Path, help="folder for real_beam.json and real_beam.png")
    chosen = parser.parse_args()
    if not (chosen.folder / "gravity.csv").exists():
        parser.error(f"{chosen.folder} holds no gravity.csv, the take without a weight")
    cells = (6, 2, 2) if chosen.quick else (10, 3, 3)
    if chosen.branches:
        return branches(chosen, cells)
    gravity = recording_of(chosen.folder, "gravity")
    result = fitted(beam(cells), gravity, 1e-2)
    figures = {"machine": describe(), "cells": cells, "dt": 1e-2, "poisson": 0.499, **summary_of(result)}
    takes = takes_in(chosen.folder, cells)
    figures["settled_young"] = settled_young([takes["gravity"]], figures["young"])
    figures["predictions"] = heights(takes, figures["young"])
    figures["predictions_from_settled_young"] = heights(takes, figures["settled_young"])
    together = settled_young(list(takes.values()), figures["young"])
    figures["settled_together"] = {"young": together, **heights(takes, together)}
    save("real_beam", figures, chosen.out)
    drawn = {"smoothed rows, second order": result}
    for name, other in () if chosen.quick else more(cells, gravity, result.values):
        figures[name] = summary_of(other)
        save("real_beam", figures, chosen.out)
        if name == "plain_backward_euler":
            drawn["plain rows, backward Euler"] = other
    if chosen.out:
        draw(chosen.out / "real_beam.png", drawn)
    finish("real_beam", figures, chosen.out)


if __name__ == "__main__":
    main()
