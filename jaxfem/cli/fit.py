"""`jaxfem fit`: recover material values from a recording of markers, with error bars, plots and tables."""

import argparse
import csv
import json
import sys
from pathlib import Path
from typing import Any

import jax

from jaxfem.cli.messages import warning
from jaxfem.fitting import FitError, FitResult, attach, fit, read_recording
from jaxfem.io.fit_files import FitFile, load_fit
from jaxfem.io.fit_plots import plot_fit, plot_loss
from jaxfem.io.plots import PlotError, require_matplotlib

EXIT_INTERRUPTED = 130


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "fit",
        help="recover material values from a recording",
        description="Recover Young's modulus, Poisson's ratio and damping from a recording of markers.",
    )
    parser.add_argument("file", metavar="FILE.toml", help="the fit: scene, recording, markers, what to fit")
    parser.add_argument("--recording", metavar="CSV", help="the recording, instead of the one in the file")
    parser.add_argument("--out", metavar="FOLDER", help="where results go, instead of [output] folder")
    parser.add_argument("--no-plots", action="store_true", help="write no PNG files")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fit and write the results; 0 when done, 130 when interrupted (with the best so far written)."""
    file = load_fit(args.file)
    result = fit_from_file(file, args.recording)
    folder = Path(args.out) if args.out else file.folder
    written = write_results(folder, result, plots=not args.no_plots)
    print(f"{file.source.name}:\n{result.summary()}\nwrote {', '.join(p.name for p in written)} in {folder}")
    return EXIT_INTERRUPTED if result.status == "interrupted" else 0


def fit_from_file(file: FitFile, recording: Any = None) -> FitResult:
    """Run the fit of a file, on another `recording` (path of a CSV file) where one is given; a line of progress."""
    if file.scene.precision == "float64":
        jax.config.update("jax_enable_x64", True)
    source = recording or file.recording
    if source is None:
        raise FitError(f'{file.source} names no recording: add recording = "FILE.csv", or give --recording FILE.csv')
    samples = read_recording(source, **file.reading)
    model, params, state = file.scene.build()
    dt = samples.spacing / file.substeps if file.substeps else file.scene.dt
    with Ticker() as ticker:
        return fit(
            model, params, state, samples, attach(model, file.places), dt=dt, progress=ticker.show, **file.settings
        )


def write_results(folder: Path, result: FitResult, plots: bool = True) -> list[Path]:
    """fitted.json, summary.txt, residuals.csv and, unless matplotlib is missing, two plots; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    values = folder / "fitted.json"
    values.write_text(json.dumps(as_json(result), indent=2) + "\n", encoding="utf-8")
    summary = folder / "summary.txt"
    summary.write_text(result.summary() + "\n", encoding="utf-8")
    written = [values, summary, _write_residuals(folder / "residuals.csv", result)]
    if plots:
        try:
            require_matplotlib()
        except PlotError as problem:
            warning(f"{problem}; going on without them")
            return written
        written.append(plot_loss(folder / "loss.png", result))
        written.append(plot_fit(folder / "measured_against_simulated.png", result))
    return written


def as_json(result: FitResult) -> dict[str, Any]:
    """The numbers of a result as plain lists and dictionaries."""
    return {
        "values": result.values,
        "standard_errors": result.standard_errors,
        "units": {each.name: each.unit for each in result.constants},
        "correlation": result.correlation.tolist(),
        "loss": result.loss,
        f"residual_rms_{result.unit}": result.noise,
        "release_s": result.release,
        "release_interval_s": list(result.release_interval),
        "samples": len(result.times),
        "markers": list(result.markers),
        "simulations": len(result.history),
        "status": result.status,
        "repairs": list(result.repairs),
        "warnings": list(result.warnings),
    }


def _write_residuals(path: Path, result: FitResult) -> Path:
    """A row a sample and marker: measured and simulated place in the body's frame, and their difference [m]."""
    kinds = ("measured", "simulated", "residual")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "marker", *(f"{kind}_{axis}_{result.unit}" for kind in kinds for axis in "xyz")])
        for k, time in enumerate(result.times):
            for m, name in enumerate(result.markers):
                cells = [v for each in (result.measured, result.simulated, result.residuals) for v in each[k, m]]
                writer.writerow([f"{time:.9g}", name, *("" if v != v else f"{v:.7g}" for v in cells)])
    return path


class Ticker:
    """One line on a terminal that tells how far a fit is; nothing where the output goes to a file."""

    def __init__(self) -> None:
        self.shown, self.best = sys.stderr.isatty(), float("inf")

    def __enter__(self) -> "Ticker":
        if self.shown:
            print("compiling ...", end="", file=sys.stderr, flush=True)
        return self

    def __exit__(self, *problem: Any) -> None:
        if self.shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def show(self, stage: str, iteration: int, loss: float, values: dict[str, float]) -> None:
        """Stage, count of simulations, best loss, the values tried."""
        self.best = min(self.best, loss)
        if self.shown:
            listed = "  ".join(f"{name} {value:.4g}" for name, value in values.items())
            line = f"{stage:<10} simulation {iteration + 1:3d}  best loss {self.best:.3g}  {listed}"
            print(f"\r\x1b[K{line[:110]}", end="", file=sys.stderr, flush=True)
