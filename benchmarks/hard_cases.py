"""Hard cases, one a line: right, flagged by name, or silent.  python benchmarks/hard_cases.py [--quick] [--out FOLDER]

`--only WORDS` takes the cases whose name or group holds one of the comma-separated WORDS, `--routes` and `--dtypes`
those ways of running them; `--every-route` those of the quick half by all. Each case in benchmarks/hard/ says what is
wanted; its line says whether that held ("right"), or whether a status, a warning or an error said so ("flagged: ..."),
or nothing did ("SILENT: ..."). Columns: energy growth over kinetic, elastic and weight energy; momentum lost where
nothing outside acts; recovery, the distance from the undeformed shape over the size; most iterations of a step; status.
Results: hard_cases.csv, .json and .png; `python benchmarks/hard/page.py` puts them into docs/hard_cases.md.
"""

import argparse
import csv
import json
import os
import pathlib
import time
from collections import Counter
from typing import Any

from jaxfem.cli.xla_flags import NO_OPTIMISATION, OLDER_EMITTER, ask_for

# Programs this small need no fast code: they compile in a third of the time.
ask_for(NO_OPTIMISATION, OLDER_EMITTER)

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from hard import contact, jointed, shapes, slopes, soft, values  # noqa: E402, F401
from hard.case import CASES, Case, Setting, judged  # noqa: E402
from hard.table import COLUMNS, picture  # noqa: E402
from machine import describe  # noqa: E402
from spread import spread  # noqa: E402

DTYPES = ("float64", "float32")
PACE = 10.0  # s between results that are written


def settings(each: Case, quick: bool) -> list[Setting]:
    """How a case is run: by its first route in double precision where that must be quick, else in all ways."""
    routes = each.routes[:1] if quick or each.long else each.routes
    return [Setting(route, dtype) for route in routes for dtype in DTYPES[: 1 if quick else 2]]


def chosen(options: argparse.Namespace) -> list[tuple[Case, Setting]]:
    """The cases and settings asked for."""
    words = [word.strip() for word in options.only.split(",")] if options.only else [""]
    picked = []
    for each in CASES.values():
        if (options.quick and not each.quick) or not any(word in f"{each.name} {each.group}" for word in words):
            continue
        for at in settings(each, options.quick and not options.every_route):
            wanted = options.routes is None or at.route in options.routes.split(",")
            if wanted and at.dtype in options.dtypes.split(","):
                picked.append((each, at))
    # Long ones last, those of one setting together: what a process has compiled is given up between settings.
    return sorted(picked, key=lambda pair: (pair[0].long, pair[1].dtype != "float64", pair[1].route))


def write(lines: list[dict[str, Any]], out: pathlib.Path, seconds: float) -> None:
    """hard_cases.csv, hard_cases.json and hard_cases.png in a folder."""
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "hard_cases.csv", "w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
        table.writeheader()
        table.writerows(lines)
    counts = Counter(line["outcome"].split(":")[0] for line in lines)
    figures = {"machine": describe(), "outcomes": dict(counts), "lines": lines, "benchmark_s": round(seconds, 1)}
    (out / "hard_cases.json").write_text(json.dumps(figures, indent=1) + "\n")
    picture(lines, out / "hard_cases.png")


def among_kept(out: pathlib.Path, fresh: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The lines of earlier results in a folder, those that were run again replaced, and new ones after them."""

    def key(line: dict[str, Any]) -> tuple[str, ...]:
        return line["case"], line["route"], line["dtype"]

    path = out / "hard_cases.json"
    old = json.loads(path.read_text())["lines"] if path.exists() else []
    lines = {key(line): line for line in [*old, *fresh]}
    return list(lines.values())


LAST: list[Setting] = []
"""How this process ran its last case."""


def line_of(name: str, at: Setting) -> dict[str, Any]:
    """A case's line. What a process has compiled is given up between settings."""
    if LAST and LAST[0] != at and "JAX_COMPILATION_CACHE_DIR" in os.environ:
        jax.clear_caches()
    LAST[:] = [at]
    return judged(CASES[name], at)


def main() -> None:
    """Run what is asked for, print a line each, and write the results as they come."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the quick half, each by one route in double precision")
    parser.add_argument("--every-route", action="store_true", help="with --quick: by all routes, in both precisions")
    parser.add_argument("--only", help="comma-separated words, one of which is in a case's name or group")
    parser.add_argument("--routes", help="comma-separated routes")
    parser.add_argument("--dtypes", default=",".join(DTYPES))
    parser.add_argument("--shapes", type=pathlib.Path, help="only draw some soft cubes on their way back, to this PNG")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the results")
    parser.add_argument("--processes", type=int, default=1, help="how many share the work; seconds are then no measure")
    parser.add_argument("--keep", action="store_true", help="with --out: keep the lines there that are not run again")
    options = parser.parse_args()
    if options.shapes:
        shapes.draw(options.shapes)
        return
    begun, written = time.perf_counter(), -PACE
    picked, found, lines = chosen(options), {}, []
    if options.processes > 1:  # the longest first
        picked = sorted(picked, key=lambda pair: not pair[0].long)
    for number, line in spread(line_of, [(each.name, at) for each, at in picked], options.processes):
        found[number] = line
        lines = [found[each] for each in sorted(found)]
        print(
            f"{line['case']} | {line['route']} | {line['dtype']} | {line['outcome']} | {line['seconds']} s", flush=True
        )
        spent = time.perf_counter() - begun
        if options.out and (spent > written + PACE or len(found) == len(picked)):
            write(among_kept(options.out, lines) if options.keep else lines, options.out, spent)
            written = time.perf_counter() - begun
    print(json.dumps(dict(Counter(line["outcome"].split(":")[0] for line in lines))))


if __name__ == "__main__":
    main()
