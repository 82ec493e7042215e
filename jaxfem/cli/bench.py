"""`jaxfem bench`: standard scenes on this machine; time against error, compile time, memory, gradient cost."""

import argparse
import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import jax

from jaxfem.cli.exits import FAILED
from jaxfem.cli.measuring import QUICK, STANDARD, Row, count_rows, machine, measure
from jaxfem.cli.messages import error, warning
from jaxfem.cli.progress import Progress
from jaxfem.io.plots import PlotError, plot_work, require_matplotlib


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "bench",
        help="time standard scenes on this machine",
        description="Step standard scenes at several tolerances on this machine: time beside error, compile time, "
        "memory, cost of a gradient. Takes some minutes.",
    )
    parser.add_argument("--out", metavar="FOLDER", default="bench", help="where tables and plot go (default: bench)")
    parser.add_argument("--quick", action="store_true", help="one small scene: does it work, rather than how fast")
    parser.set_defaults(run=run, kept=False)  # a program that was kept would not tell what it takes to compile


def run(args: argparse.Namespace) -> int:
    """Measure, print, write; 0 when every solve converged, 3 otherwise."""
    jax.config.update("jax_enable_x64", True)
    scenes, repeats = (QUICK, 1) if args.quick else (STANDARD, 5)
    rows: list[Row] = []
    with Progress(count_rows(scenes), "measurement") as bar:
        for scene in scenes:
            rows += measure(scene, repeats, lambda note: bar.advance(1, note))
    print(table(rows))
    print(f"\n{machine()}")
    folder = Path(args.out)
    names = _write(folder, rows)
    print(f"wrote {', '.join(names)} in {folder}")
    failed = [row for row in rows if row.status]
    for row in failed:
        error(f"{row.scene}, {row.precision}, tolerance {row.tolerance:g}: a solve did not converge")
    return FAILED if failed else 0


def table(rows: list[Row]) -> str:
    """The measurements as text; what is measured once a precision stands in its line at 1e-4."""
    head: tuple[str, ...] = ("scene", "elements", "precision", "tolerance", "iterations", "ms/step", "steps/s", "error")
    head += ("compile s", "memory MB", "gradient/run")
    lines = [head]
    for row in rows:
        once = (row.compile_s, row.memory_mb, row.gradient_ratio)
        lines.append(
            (
                row.scene,
                str(row.elements),
                row.precision,
                f"{row.tolerance:.0e}",
                f"{row.iterations:.1f}",
                f"{row.ms_per_step:.3g}",
                f"{row.steps_per_second:.4g}",
                f"{row.error:.1e}",
                *("" if value is None else f"{value:.3g}" for value in once),
            )
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = ("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)
    return "\n".join(text.rstrip() for text in texts)


def _write(folder: Path, rows: list[Row]) -> list[str]:
    folder.mkdir(parents=True, exist_ok=True)
    records = [dataclasses.asdict(row) for row in rows]
    (folder / "bench.json").write_text(json.dumps({"machine": machine(), "rows": records}, indent=2) + "\n")
    with (folder / "bench.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(records[0]))
        writer.writeheader()
        writer.writerows(records)
    names = ["bench.json", "bench.csv"]
    try:
        require_matplotlib()
    except PlotError as problem:
        warning(f"{problem}; going on without")
        return names
    lines: dict[str, tuple[list[float], list[float]]] = {}
    for row in rows:
        times, errors = lines.setdefault(f"{row.scene}, {row.precision}", ([], []))
        times.append(row.ms_per_step)
        errors.append(row.error)
    plot_work(folder / "time_against_error.png", lines)
    return [*names, "time_against_error.png"]
