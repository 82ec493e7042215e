"""Plots of a fit: how the loss fell, and measured against simulated markers."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.fitting.result import FitResult
from jaxfem.io.plots import COLOURS, _figure, _save

BACKED = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
MOST_MARKERS = 8  # panels that still can be read


def plot_loss(path: Any, result: FitResult) -> Path:
    """Loss of every simulation of a fit, coloured by stage, with the best so far; below it each parameter."""
    names = list(result.values)
    figure = _figure(7.2, 2.9 + 1.5 * len(names))
    heights = [2.2] + [1.0] * len(names)
    axes = figure.subplots(1 + len(names), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    losses = np.array([visit.loss for visit in result.history])
    stages = np.array([visit.stage for visit in result.history])
    numbers = np.arange(1, len(losses) + 1)
    axes[0].step(numbers, np.fmin.accumulate(losses), where="post", color="0.7", linewidth=1.2, label="best so far")
    kinds = list(dict.fromkeys(stages))
    for kind, colour in zip(kinds, COLOURS, strict=False):
        chosen = stages == kind
        axes[0].plot(numbers[chosen], losses[chosen], "o", color=colour, markersize=3.5, label=kind)
        for row, name in zip(axes[1:], names, strict=True):
            values = np.array([visit.values[name] for visit in result.history])
            row.plot(numbers[chosen], values[chosen], "o", color=colour, markersize=3)
    axes[0].set_yscale("log")
    axes[0].set_ylabel("loss")
    axes[0].legend(frameon=False, fontsize=8, ncols=2, loc="upper right")
    for row, each in zip(axes[1:], result.constants, strict=True):
        row.axhline(result.values[each.name], color="0.6", linewidth=0.8, zorder=0)
        row.set_yscale("log" if each.transform.proportional else "linear")
        row.set_ylabel(f"{each.title}\n{f'({each.unit})' if each.unit else ''}".strip(), fontsize=8)
    axes[-1].set_xlabel("simulation")
    for row in axes:
        _plain(row)
    figure.align_ylabels(axes)
    return _save(figure, path)


def plot_fit(path: Any, result: FitResult) -> Path:
    """A panel for each marker and axis: measured displacement as points, simulated as a line, in mm (or px) over s.

    Panels of one axis share their scale, so that what moves stands out; the root mean square residual stands in each.
    With more than eight markers, the eight that move most are shown.
    """
    first = result.simulated[0]
    scale, unit = (1e3, "mm") if result.unit == "m" else (1.0, result.unit)
    simulated, measured = (scale * (each - first) for each in (result.simulated, result.measured))
    motion = np.nanmax(np.abs(simulated), axis=(0, 2))
    shown = sorted(np.argsort(-motion)[:MOST_MARKERS])
    figure = _figure(9.6, 0.7 + 1.45 * len(shown))
    panels = figure.subplots(len(shown), 3, sharex=True, sharey="col", squeeze=False)
    for row, marker in zip(panels, shown, strict=True):
        for axis, panel in enumerate(row):
            colour = COLOURS[axis]
            panel.plot(result.times, measured[:, marker, axis], ".", color="0.55", markersize=3.2, label="measured")
            panel.plot(result.times, simulated[:, marker, axis], color=colour, linewidth=1.3, label="simulated")
            off = (simulated - measured)[:, marker, axis]
            left = np.sqrt(np.mean(off[np.isfinite(off)] ** 2)) if np.isfinite(off).any() else np.nan
            panel.text(
                0.98,
                0.06,
                f"rms {left:.2g} {unit}" if np.isfinite(left) else "not seen",
                transform=panel.transAxes,
                ha="right",
                fontsize=7,
                color="0.3",
                bbox=BACKED,
            )
            _plain(panel)
        row[0].set_ylabel(f"{result.markers[marker]}\n({unit})", fontsize=9)
    for axis, panel in enumerate(panels[0]):
        panel.set_title(f"displacement along {'xyz'[axis]}", fontsize=10)
    for panel in panels[-1]:
        panel.set_xlabel("time since release (s)", fontsize=9)
    handles = panels[0, 1].get_legend_handles_labels()
    figure.legend(*handles, frameon=False, fontsize=9, ncols=2, loc="outside upper center")
    return _save(figure, path)


def _plain(axes: Any) -> None:
    axes.grid(True, color="0.92")
    axes.set_axisbelow(True)
    axes.margins(x=0.02)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
