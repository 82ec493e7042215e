"""The pictures of docs/papers.md, from the figures alone."""

import pathlib
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def pictures(figures: dict[str, Any], folder: pathlib.Path) -> None:
    """PNG files of what the figures hold."""
    for paper, part, draw, name in (
        ("A", "few_iterations", _few, "few_iterations"),
        ("A", "bricks", _bricks, "bricks"),
        ("B", "convergence", _orders, "springs"),
        ("C", "times", _times, "groups"),
        ("C", "equal_error", _errors, "equal_error"),
    ):
        if part in figures.get(paper, {}):
            draw(figures[paper][part], folder / f"papers_{name}.png")


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


def _bricks(given: dict[str, Any], path: pathlib.Path) -> None:
    figure, axes = _axes("compliance of the rows, times that of 1 GPa", "iterations a step")
    for solver in dict.fromkeys(row["solver"] for row in given["ours"]):
        rows = [row for row in given["ours"] if row["solver"] == solver]
        axes.plot([row["compliance"] for row in rows], [row["iterations"] for row in rows], marker="o", label=solver)
    for name, theirs in given["paper"].items():
        axes.axhline(theirs["iterations"], color="0.5", ls=":", label=f"paper, {name} regularisation")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path)


def _errors(rows: list[dict[str, Any]], path: pathlib.Path) -> None:
    softest = min(row["young"] for row in rows)
    figure, axes = _axes("error of the end's height, share of its way", "time of a run of 0.2 s (s)")
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method and row["young"] == softest]
        style = "--" if method.startswith("condensed") else "-"
        axes.plot([row["error"] for row in own], [row["seconds"] for row in own], style, marker="o", label=method)
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path)
