"""A picture of soft cubes that start flattened, mirrored, as a line, a point and at random, and of a crushed one."""

import pathlib
from typing import Any

import numpy as np

from hard.case import Setting
from hard.running import roll
from hard.soft import anywhere, mirrored
from hard.worlds import DT, floor_cube, free_cube
from jaxfem.mesh.topology import boundary_faces

STARTS: dict[str, Any] = {
    "flattened": lambda x: x * (1, 1, 0),
    "line": lambda x: x * (1, 0, 0),
    "point": lambda x: x * 0,
    "random": anywhere(0),
    "mirrored": mirrored(5),
}
SHOWN = (0, 1, 2, 8, 40)  # frames, of five steps each


def draw(path: pathlib.Path) -> None:
    """Run them and draw a row a start, a column a time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    at = Setting("condensed", "float64")
    world = free_cube(at)
    rows = {name: roll(world, DT, 200, world.moved(change)).frames for name, change in STARTS.items()}
    floor = floor_cube(at)
    heavy = roll(floor, DT, 20, None, floor.params.replace(gravity=floor.params.gravity * 200))
    rows["200 g and back"] = [*heavy.frames[:3], *roll(floor, DT, 200, heavy.end).frames]
    triangles = boundary_faces(np.asarray(world.model.elements.cells))[0]
    figure = Figure(figsize=(8, 1.6 * len(rows)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for row, (name, frames) in enumerate(rows.items()):
        for column, shown in enumerate(SHOWN):
            places = np.asarray(frames[min(shown, len(frames) - 1)].positions)
            axes = figure.add_subplot(len(rows), len(SHOWN), row * len(SHOWN) + column + 1, projection="3d")
            axes.plot_trisurf(*places.T, triangles=triangles, color="#8fb8de", edgecolor="#1f3a5f", linewidth=0.3)
            middle = places.mean(0)
            for axis, centre in zip("xyz", middle, strict=True):
                getattr(axes, f"set_{axis}lim")(centre - 0.07, centre + 0.07)
            axes.set_box_aspect((1, 1, 1))
            axes.set_axis_off()
            if row == 0:
                axes.set_title(f"after {5 * shown} steps", fontsize=8)
            if column == 0:
                axes.text2D(0.0, 0.9, name, transform=axes.transAxes, fontsize=8)
    figure.savefig(path)
