"""`jaxfem compare`: one scene with several methods and settings; time a step against error to a converged run."""

import argparse
import csv
import dataclasses
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxfem.cli.exits import FAILED
from jaxfem.cli.measuring import machine
from jaxfem.cli.messages import warning
from jaxfem.cli.progress import Progress
from jaxfem.declared.scene import SceneError
from jaxfem.io.plots import PlotError, plot_work, require_matplotlib
from jaxfem.io.scene_files import COMPARE_KEYS, SceneFile, SceneFileError, load_scene, method_settings, read_method
from jaxfem.io.toml_tables import Table, is_number, read_toml
from jaxfem.methods import METHODS, Method
from jaxfem.solvers import describe
from jaxfem.stepping import prepare, rollout

USUAL = ("corotated", "assembled", "groupwise", "mass_spring")
FINER = 8
"""Steps of the converged run in one of the scene's."""
LEAST = 2
"""How many steps of the converged run the shortest step compared must hold."""
REPEATS = 3


@dataclasses.dataclass(frozen=True)
class Line:
    """One run: its `label` (method and settings), step [s], tolerance, time a step and in all [ms], error [m] and as a
    share of the largest displacement, steps whose solve failed with the first one's words."""

    label: str
    step: float
    tolerance: float | None
    ms_per_step: float
    ms_in_all: float
    error_m: float
    error: float
    failed: int
    words: str


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "compare",
        help="run a scene with several methods: time against error",
        description="Run a scene with several methods, steps and tolerances, and compare each with a converged run: "
        "that of the scene's own method at a much finer step. A table [compare] may say which.",
    )
    parser.add_argument(
        "file",
        metavar="SCENE.toml",
        help="the scene; its [compare] table may hold methods, step_factors, tolerances and finer",
    )
    parser.add_argument("--out", metavar="FOLDER", help="where tables and plot go (default: NAME_compared)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compare; 0 where all solves converged, 3 otherwise."""
    file = load_scene(args.file)
    if file.precision == "float64":
        jax.config.update("jax_enable_x64", True)
    if not file.scene.soft:
        raise SceneFileError(f"{args.file} holds no soft body: errors are those of soft bodies' nodes")
    table = Table(read_toml(Path(args.file)), "the top level", None).table("compare", COMPARE_KEYS, "[compare]")
    cases = list(_cases(table, file))
    finer = table.integer("finer", FINER)
    shortest = min(factor for _, _, factor, _ in cases)
    if finer * shortest < LEAST:
        raise SceneFileError(
            f"[compare] measures errors by a run of {finer} steps in one of the scene's, and takes steps of "
            f"{shortest:g} of it: give finer = {math.ceil(LEAST / shortest)} or more, so that it is finer"
        )
    folder = Path(args.out) if args.out else file.source.parent / f"{file.source.stem}_compared"
    lines = _compared(file, cases, finer)
    print(shown(lines))
    for line in lines:
        if line.failed:
            warning(f"{line.label}: {line.failed} of its solves failed: {line.words}")
    _write(folder, lines)
    print(f"errors are distances of nodes at the end, largest, from a run of {finer} times as many steps; {machine()}")
    print(f"wrote compare.csv, compare.json and compare.png in {folder}")
    return FAILED if any(line.failed for line in lines) else 0


def _cases(table: Table, file: SceneFile) -> Iterator[tuple[str, Any, float, float | None]]:
    """(label, method, step factor, tolerance) of each run."""
    given = table.get("methods") if "methods" in table else list(USUAL)
    factors = table.get("step_factors") if "step_factors" in table else [1.0]
    tolerances = table.get("tolerances") if "tolerances" in table else [file.tolerance]
    for key, values in (("methods", given), ("step_factors", factors), ("tolerances", tolerances)):
        if not isinstance(values, list) or not values:
            raise table.wrong(key, "a list with at least one entry")
    for each in given:
        label, method = _method(table, each)
        for factor in factors:
            if not is_number(factor) or factor <= 0 or not _whole(file.steps / factor):
                raise table.wrong("step_factors", f"numbers above 0 that divide the scene's {file.steps} steps")
            for tolerance in tolerances:
                if tolerance is not None and not (is_number(tolerance) and 0 < tolerance < 1):
                    raise table.wrong("tolerances", "relative residuals between 0 and 1, like 1e-8")
                yield label, method, float(factor), tolerance


def _whole(number: float) -> bool:
    return number > 0.5 and abs(number - round(number)) < 1e-9 * number


def _method(table: Table, given: Any) -> tuple[str, str | Method]:
    """A method by its word, or from a table with its settings, { method = "groupwise", groups = 2 }; and its label."""
    if isinstance(given, str) and given in (*METHODS.words(), "auto"):
        return given, given
    if isinstance(given, dict) and isinstance(given.get("method"), str) and given["method"] in METHODS:
        word, settings = given["method"], {key: value for key, value in given.items() if key != "method"}
        known = method_settings(word)
        for key in settings:
            if key not in known:
                has = f"it has {', '.join(known)}" if known else "it has none"
                raise SceneFileError(f'the method "{word}" has no setting {key!r}; {has}')
        words = ", ".join(f"{key} {value}" for key, value in settings.items())
        return f"{word} ({words})" if words else word, read_method(Table(given, "methods of [compare]", None), word)
    raise table.wrong(
        "methods",
        f'a list of words ({", ".join(METHODS.words())}), or tables like {{ method = "groupwise", groups = 2 }}',
    )


def _compared(file: SceneFile, cases: list[Any], finer: int) -> list[Line]:
    """All runs, and what each costs and misses."""
    lines, refused = [], []
    with Progress(len(cases) + 1, "run") as bar:
        bar.compiling()
        model, params, state = file.build()
        found = rollout(model, params, state, file.dt / finer, file.steps * finer, every=file.steps * finer)
        _check_converged(found[1], finer)
        end = _end(found)
        size = float(np.linalg.norm(end - np.asarray(model.rest), axis=1).max())
        bar.advance(1, "the converged run")
        for label, method, factor, tolerance in cases:
            try:
                made = dataclasses.replace(file, solver=method, tolerance=tolerance).build()
            except SceneError as problem:
                refused.append(f"{label}: {problem}")
                bar.advance(1, label)
                continue
            lines.append(_line(file, label, made, factor, tolerance, end, size))
            bar.advance(1, label)
    for each in refused:
        warning(f"left out, {each}")
    if not lines:
        raise SceneFileError("no method of [compare] serves this scene: " + "; ".join(refused))
    return lines


def _check_converged(info: Any, finer: int) -> None:
    """Refuse to measure errors by a run that failed itself."""
    failed = np.flatnonzero(np.asarray(info.status))
    if len(failed):
        words = describe(np.asarray(info.status)[failed[0]])
        raise SceneFileError(
            f"the run of {finer} times as many steps, which errors are measured by, failed: {words}. Mend the scene, "
            "or give another `finer` in [compare]"
        )


def _line(
    file: SceneFile, label: str, made: Any, factor: float, tolerance: float | None, end: np.ndarray, size: float
) -> Line:
    model, params, state = made
    dt, steps = file.dt * factor, round(file.steps / factor)
    ready = prepare(model, params, state, dt)
    found = jax.block_until_ready(rollout(ready, params, state, dt, steps))  # compiles
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        found = jax.block_until_ready(rollout(ready, params, state, dt, steps))
        times.append(time.perf_counter() - begun)
    status = np.asarray(found[1].status)
    failed = np.flatnonzero(status)
    off = float(np.linalg.norm(_end(found) - end, axis=1).max())
    words = describe(status[failed[0]]) if len(failed) else ""
    seconds = min(times)  # what disturbs only adds
    return Line(
        f"{label}" + (f", step x {factor:g}" if factor != 1 else ""),
        dt,
        tolerance,
        1e3 * seconds / steps,
        1e3 * seconds,
        off,
        off / size if size else 0.0,
        len(failed),
        words,
    )


def _end(found: Any) -> np.ndarray:
    return np.asarray(found[0].positions[-1], np.float64)


def shown(lines: list[Line]) -> str:
    """The comparison as text."""
    rows = [("method", "step s", "tolerance", "ms/step", "ms in all", "error m", "of movement", "failed")]
    for each in lines:
        tolerance = "" if each.tolerance is None else f"{each.tolerance:.0e}"
        numbers = f"{each.ms_per_step:.3g}", f"{each.ms_in_all:.3g}", f"{each.error_m:.2e}", f"{each.error:.1%}"
        rows.append((each.label, f"{each.step:.3g}", tolerance, *numbers, str(each.failed) if each.failed else ""))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    texts = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
    return "\n".join(texts)


def _write(folder: Path, lines: list[Line]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    records = [dataclasses.asdict(line) for line in lines]
    (folder / "compare.json").write_text(json.dumps({"machine": machine(), "rows": records}, indent=2) + "\n")
    with (folder / "compare.csv").open("w", newline="", encoding="utf-8") as table:
        writer = csv.DictWriter(table, list(records[0]))
        writer.writeheader()
        writer.writerows(records)
    try:
        require_matplotlib()
    except PlotError as problem:
        warning(f"{problem}; going on without")
        return
    drawn: dict[str, tuple[list[float], list[float]]] = {}
    for line in lines:
        times, errors = drawn.setdefault(line.label.partition(", step x")[0], ([], []))
        times.append(line.ms_in_all)
        errors.append(max(line.error, 1e-16))
    plot_work(folder / "compare.png", drawn, "time in all (ms)")
