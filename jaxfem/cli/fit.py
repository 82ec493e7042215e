"""`jaxfem fit`: recover material values from a recording of markers, with error bars, plots and tables."""

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxfem.cli.exits import INTERRUPTED
from jaxfem.cli.fit_field import check_field, field_of, write_field
from jaxfem.cli.further import Step, gone_on, with_contributions, with_profiles
from jaxfem.cli.messages import warning
from jaxfem.cli.progress import Ticker
from jaxfem.fitting import (
    FitError,
    FitResult,
    Take,
    alone,
    attach,
    fit_takes,
    read_recording,
    refine,
    sample,
)
from jaxfem.fitting.posterior import WARMUP, blackjax_or_error
from jaxfem.io.fit_after_page import after_parts
from jaxfem.io.fit_files import FitFile, TakeEntry, load_fit
from jaxfem.io.fit_json import as_json
from jaxfem.io.fit_plots import plot_fit, plot_loss
from jaxfem.io.fit_report import write_report
from jaxfem.io.plots import PlotError, require_matplotlib
from jaxfem.io.scene_files import SceneFile, SceneFileError, load_scene


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
    parser.add_argument(
        "--profiles",
        action="store_true",
        help="profiles, and what held values, places and sizes add, in the page",
    )
    parser.add_argument(
        "--refine",
        action="store_true",
        help="refit at half the time step and on a mesh of eight times the elements: the discretisation's share",
    )
    parser.add_argument("--alone", action="store_true", help="fit each take by itself, too, and say whether they agree")
    parser.add_argument(
        "--posterior",
        metavar="DRAWS",
        type=int,
        nargs="?",
        const=500,
        help="draw from the parameters' posterior, DRAWS (500) in each of four chains (needs jaxfem[posterior])",
    )
    parser.add_argument("--force", action="store_true", help="replace the results of an earlier fit")
    parser.set_defaults(run=run, quick=True)


def run(args: argparse.Namespace) -> int:
    """Fit and write the results; 0 when done, 130 when interrupted (with the best so far written)."""
    file = load_fit(args.file)
    check_field(file)
    if args.posterior is not None:
        blackjax_or_error()  # before the fit, not after it
    if args.alone and (args.recording or sum(not each.held_out for each in file.takes) < 2):
        raise FitError("--alone compares takes, and only one is fitted: give several [[take]] tables")
    folder = Path(args.out) if args.out else file.folder
    if not args.force:
        _refuse_old(folder / "fitted.json")
    more = Further(args.profiles, args.refine, args.alone, args.posterior)
    result, written, code = fitted(file, folder, args.recording, not args.no_plots, more)
    print(f"{file.source.name}:\n{result.summary()}\nwrote {', '.join(p.name for p in written)} in {folder}")
    return code


class Further(NamedTuple):
    """What is asked for beyond the fit: `profiles` with Type B, `finer` refits, each take `alone`, `draws` from the
    posterior."""

    profiles: bool = False
    finer: bool = False
    apart: bool = False
    draws: int | None = None


def fitted(
    file: FitFile, folder: Path, recording: Any = None, plots: bool = True, more: Further | None = None
) -> tuple[FitResult, list[Path], int]:
    """Run the fit of a file and write everything into `folder`, the page among it; returns what was written, too, and
    the exit code."""
    result, takes = fit_from_file(file, recording)
    code, fields = INTERRUPTED, list[tuple[Path, str]]()
    if result.status != "interrupted":
        steps = _steps(file, recording, takes, more or Further())
        if file.field:
            steps.append(("field", lambda found, _: _with_field(file, folder, found, takes, fields)))
        if steps:
            write_results(folder, result, plots=False)  # what follows may take long, or end badly
        result, code = gone_on(result, steps)
    written = write_results(folder, result, plots)
    after = after_parts(result)
    written, after = [*written, *(path for path, _ in fields)], [*after, *(part for _, part in fields)]
    files = {"fit": file.source, **_sources(file, recording)}
    scene = takes[0].model, takes[0].state
    settings = {**file.cutting, **file.settings}
    written.insert(1, write_report(folder / "report.html", result, scene, files, settings, after))
    return result, written, code


def _drawn(result: FitResult, ticker: Ticker, draws: int, seed: int) -> FitResult:
    """The result with so many draws of its posterior."""
    return sample(result, draws, seed=seed, progress=lambda done: ticker.count("posterior: draw", done, draws))


def _with_field(
    file: FitFile, folder: Path, result: FitResult, takes: Sequence[Take], fields: list[tuple[Path, str]]
) -> FitResult:
    """The field's file and its part of the page, added to `fields`."""
    fields.append(write_field(folder, field_of(file, result, takes), takes[0].model))
    return result


def _steps(file: FitFile, recording: Any, takes: Sequence[Take], more: Further) -> list[Step]:
    """What follows the fit, in order."""
    steps: list[Step] = []
    if more.finer:
        steps.append(
            ("finer refits", lambda found, told: refine(found, takes_of(file, recording, finer=True), told.show))
        )
    if more.apart:
        steps.append(("takes alone", lambda found, told: alone(found, takes, progress=told.show, **file.settings)))
    if more.profiles:
        steps.append(("profiles", with_profiles))
        steps.append(("Type B", lambda found, told: with_contributions(found, told, takes)))
    if more.draws is not None:
        draws, seed = more.draws, file.settings["seed"]
        name = f"posterior ({WARMUP} steps of warm-up first)"
        steps.append((name, lambda found, told: _drawn(found, told, draws, seed)))
    return steps


def fit_from_file(file: FitFile, recording: Any = None) -> tuple[FitResult, list[Take]]:
    """Run the fit of a file, on another `recording` (path of a CSV file) where one is given; a line of progress."""
    if file.scene.precision == "float64":
        jax.config.update("jax_enable_x64", True)
    takes = takes_of(file, recording)
    with Ticker() as ticker:
        return fit_takes(takes, progress=ticker.show, **file.settings), takes


def takes_of(file: FitFile, recording: Any = None, finer: bool = False) -> list[Take]:
    """The takes of a fit file, those held out behind the others; `finer`: their scenes with refined meshes."""
    entries = file.takes
    if not entries or recording:
        source = recording or file.recording
        if source is None:
            raise FitError(
                f'{file.source} names no recording: add recording = "FILE.csv", or give --recording FILE.csv'
            )
        entries = (TakeEntry(Path(source).stem, file.scene, Path(source), file.reading, False, file.cutting),)
    takes = []
    for each in sorted(entries, key=lambda entry: entry.held_out):
        samples = read_recording(each.recording, **each.reading)
        scene = load_scene(each.scene.source, finer=True) if finer else each.scene
        model, params, state = scene.build()
        dt = samples.spacing / file.substeps if file.substeps else each.scene.dt
        markers = attach(model, file.places)
        groups = groups_of(scene, model.bodies)
        takes.append(Take(model, params, state, samples, markers, dt, name=each.name, groups=groups, **each.cutting))
    return takes


def groups_of(scene: SceneFile, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Numbers of elements of the groups of all soft bodies' meshes, by BODY.GROUP; `names` of the bodies."""
    found, first = {}, 0
    for body, label in zip(scene.scene.soft, names, strict=True):
        for name, rows in body.mesh.cell_groups.items():
            if len(rows):
                found[f"{label}.{name}"] = first + np.asarray(rows)
        first += len(body.mesh.cells)
    return found


def _sources(file: FitFile, recording: Any) -> dict[str, Path]:
    """Files that a fit is made of, by what they are."""
    found = {"scene": file.scene.source}
    if file.takes and not recording:
        for each in file.takes:
            found |= {f"recording {each.name}": each.recording, f"scene {each.name}": each.scene.source}
    else:
        found["recording"] = Path(recording or file.recording or "")
    return found


def _refuse_old(values: Path) -> None:
    """Refuse to write over the results of an earlier fit."""
    if values.is_file():
        raise SceneFileError(
            f"{values} is the result of an earlier fit: give --force to replace it, or --out FOLDER for another place"
        )


def write_results(folder: Path, result: FitResult, plots: bool = True) -> list[Path]:
    """fitted.json, summary.txt, residuals.csv and, unless matplotlib is missing, two plots; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    values = folder / "fitted.json"
    values.write_text(json.dumps(as_json(result), indent=2) + "\n", encoding="utf-8")
    summary = folder / "summary.txt"
    summary.write_text(result.summary() + "\n", encoding="utf-8")
    written = [values, summary, _write_residuals(folder / "residuals.csv", result)]
    pictures = folder / "loss.png", folder / "measured_against_simulated.png"
    for old in pictures:  # of an earlier fit: they would not show this one
        old.unlink(missing_ok=True)
    if plots:
        try:
            require_matplotlib()
        except PlotError as problem:
            warning(f"{problem}; going on without them")
            return written
        written.append(plot_loss(pictures[0], result))
        written.append(plot_fit(pictures[1], result))
    return written


def _write_residuals(path: Path, result: FitResult) -> Path:
    """A row a sample and marker of each take: measured and simulated place in the body's frame, their difference."""
    kinds = ("measured", "simulated", "residual")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        names = [f"{kind}_{axis}_{result.unit}" for kind in kinds for axis in "xyz"]
        writer.writerow(["time_s", "take", "marker", *names])
        for take in result.takes:
            for k, time in enumerate(take.times):
                for m, name in enumerate(take.markers):
                    cells = [v for each in (take.measured, take.simulated, take.residuals) for v in each[k, m]]
                    numbers = ("" if v != v else f"{v:.7g}" for v in cells)
                    writer.writerow([f"{time:.9g}", take.name, name, *numbers])
    return path
