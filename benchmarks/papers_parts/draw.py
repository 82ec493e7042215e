"""The pictures of docs/papers.md, from the figures alone."""

import pathlib
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def pictures(figures: dict[str, Any], folder: pathlib.Path) -> None:
    """PNG files of what the figures hold."""
    if "A" in figures:
        _few(figures["A"]["few_iterations"], folder / "papers_few_iterations.png")
    if "B" in figures:
        _orders(figures["B"]["convergence"], folder / "papers_springs.png")
    if "C" in figures:
        _times(figures["C"]["times"], folder / "papers_groups.png")


def _axes(xlabel: str, ylabel: str, logarithmic: bool = True) -> tuple[Any, Any]:
    figure = Figure(figsize=(6.8, 4.2), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    if logarithmic:
        axes.set_xscale("log")
        axes.set_yscale("log")
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.grid(True, color="0.9")
    axes.set_axisbelow(True)
    return figure, axes


def _orders(given: dict[str, Any], path: pathlib.Path) -> None:
    figure, axes = _axes("cells a side", "error (L2, of the displacement)")
    for label, errors in given["errors"].items():
        style = "-" if label.startswith("finite") else "--"
        axes.plot(given["cells"], errors, style, marker="o", label=f"{label}: order {given['order'][label]:.2f}")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path)


def _times(rows: list[dict[str, Any]], path: pathlib.Path) -> None:
    figure, axes = _axes("elements", "time a step (ms)")
    elements = [row["elements"] for row in rows]
    for name in rows[0]["ms_per_step"]:
        known = [
            (e, row["ms_per_step"][name]) for e, row in zip(elements, rows, strict=True) if name in row["ms_per_step"]
        ]
        label = f"{name} group" + ("" if str(name) == "1" else "s") if str(name).isdigit() else str(name)
        axes.plot(*zip(*known, strict=True), "-" if str(name).isdigit() else "--", marker="o", label=label)
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path)


def _few(given: dict[str, Any], path: pathlib.Path) -> None:
    figure, axes = _axes("time (s)", "height of the chain's end (m)", logarithmic=False)
    for label, course in given["tips"].items():
        if label == "converged" or label.split()[1] in ("5", "20"):
            style = "k-" if label == "converged" else "-" if label.startswith("pgs") else "--"
            name = label.replace("pgs", "Gauss-Seidel,").replace("mprgp", "MPRGP,")
            axes.plot([(i + 1) / 60 for i in range(len(course))], course, style, label=name, lw=1)
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path)
