"""The table of hard cases as a picture: one row a case, one column a setting, a colour for how it ended."""

import pathlib
from typing import Any

COLUMNS = (
    "case",
    "group",
    "route",
    "dtype",
    "outcome",
    "wanted",
    "energy_growth",
    "linear_momentum",
    "angular_momentum",
    "recovery",
    "iterations",
    "status",
    "note",
    "seconds",
)
COLOURS = {"right": "#4c9f70", "flagged": "#e8b84a", "SILENT": "#c0392b", "crashed": "#6c3483", "not served": "#d5d8dc"}


def picture(lines: list[dict[str, Any]], path: pathlib.Path) -> None:
    """Draw it; a blank field was not run."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch, Rectangle

    rows = list(dict.fromkeys(line["case"] for line in lines))
    columns = list(dict.fromkeys((line["dtype"], line["route"]) for line in lines))
    figure = Figure(figsize=(4.2 + 0.5 * len(columns), 1.6 + 0.17 * len(rows)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for line in lines:
        x, y = columns.index((line["dtype"], line["route"])), rows.index(line["case"])
        colour = COLOURS[line["outcome"].split(":")[0]]
        axes.add_patch(Rectangle((x, y), 0.94, 0.9, color=colour, linewidth=0))
    axes.set_xlim(0, len(columns))
    axes.set_ylim(len(rows), 0)
    axes.set_yticks([y + 0.5 for y in range(len(rows))], rows, fontsize=7)
    labels = [f"{route}, {dtype}" for dtype, route in columns]
    axes.set_xticks([x + 0.5 for x in range(len(columns))], labels, rotation=60, ha="left", fontsize=7)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    patches = [Patch(color=colour, label=word) for word, colour in COLOURS.items()]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches), frameon=False, fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
