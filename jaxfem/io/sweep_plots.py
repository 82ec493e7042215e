"""Plots of a sweep: each output over each variable, and the variables in pairs, coloured by an output."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxfem.io.plots import COLOURS, _figure, _save

MOST = 6  # rows and columns of a plot
DECADE = 10  # a variable whose values span more is drawn over its logarithm


def plot_responses(path: Any, variants: Mapping[str, Any], outputs: Mapping[str, Any], good: Any) -> Path:
    """Every output (V,) over every variable (V,), a point a variant; those that failed are left out."""
    across, down = list(variants)[:MOST], list(outputs)[:MOST]
    figure = _figure(3.0 * len(across) + 1, 2.2 * len(down) + 0.6)
    axes = figure.subplots(len(down), len(across), squeeze=False)
    for row, output in enumerate(down):
        for column, name in enumerate(across):
            place = axes[row, column]
            place.plot(np.asarray(variants[name])[good], np.asarray(outputs[output])[good], ".", ms=4, color=COLOURS[0])
            place.set_xscale(_scale(variants[name]))
            if column == 0:
                place.set_ylabel(output)
            if row == len(down) - 1:
                place.set_xlabel(name)
    return _save(figure, path)


def plot_pairs(path: Any, variants: Mapping[str, Any], output: str, values: Any, good: Any) -> Path:
    """Each pair of variables, coloured by one output (V,); crosses where a variant failed."""
    names = list(variants)[:MOST]
    figure = _figure(2.4 * len(names) + 1.4, 2.4 * len(names))
    axes = figure.subplots(len(names), len(names), squeeze=False)
    shown = None
    for row, y in enumerate(names):
        for column, x in enumerate(names):
            place = axes[row, column]
            if row == column:
                place.hist(np.asarray(variants[x]), color=COLOURS[0])
            else:
                a, b = np.asarray(variants[x]), np.asarray(variants[y])
                shown = place.scatter(a[good], b[good], c=np.asarray(values)[good], s=8)
                place.plot(a[~good], b[~good], "x", ms=5, color=COLOURS[1])
                place.set_xscale(_scale(a))
                place.set_yscale(_scale(b))
            place.set(xlabel=x if row == len(names) - 1 else "", ylabel=y if column == 0 else "")
    if shown is not None:
        figure.colorbar(shown, ax=axes, label=output)
    return _save(figure, path)


def _scale(values: Any) -> str:
    low, high = np.min(values), np.max(values)
    return "log" if low > 0 and high >= DECADE * low else "linear"
