"""Command line and output that the benchmarks share: --quick, --out, JSON, a plot."""

import argparse
import json
import pathlib
import time
from typing import Any

BEGUN = time.perf_counter()


def arguments(text: str, spread: bool = False) -> argparse.Namespace:
    """Parse --quick and --out, with `spread` also --processes; `text`: the script's docstring."""
    parser = argparse.ArgumentParser(description=text.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repeats")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the figures and the plot")
    if spread:
        parser.add_argument("--processes", type=int, default=1, help="how many share the work; figures are the same")
    return parser.parse_args()


def finish(name: str, figures: dict[str, Any], out: pathlib.Path | None) -> None:
    """Write NAME.json to the folder, and print the figures as the last line; with the seconds that it all took."""
    figures = figures | {"benchmark_s": time.perf_counter() - BEGUN}
    save(name, figures, out)
    print(json.dumps(figures))


def save(name: str, figures: dict[str, Any], out: pathlib.Path | None) -> None:
    """Write NAME.json to the folder, where one is given; long runs call it as they go."""
    if out:
        out.mkdir(parents=True, exist_ok=True)
        (out / f"{name}.json").write_text(json.dumps(figures, indent=2) + "\n")


def line_plot(path: pathlib.Path, lines: dict[str, Any], xlabel: str, ylabel: str, linear: bool = False) -> None:
    """Lines of (x, y) on logarithmic axes (y linear where asked)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.2), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for label, (x, y) in lines.items():
        axes.plot(x, y, marker="o", label=label)
    axes.set_xscale("log")
    axes.set_yscale("linear" if linear else "log")
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.grid(True, color="0.9")
    axes.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
