"""Hard cases by other engines, as far as they can be told.  python benchmarks/hard_cases_others.py [--out FOLDER]

MuJoCo (flex), Newton and pyPBD, each where it is installed (pip install mujoco newton[sim] pypbd), in an environment of
its own: jaxfem is not needed. `--engines` takes some of them. The numbers and limits are
those of hard_cases.py; each engine runs with our step of 1/60 s and with the step that its own documentation takes.
"SILENT": wrong, and neither an error nor a warning of the engine's own says so. What an engine has no words for is left
out; one that is not installed is named with the reason.
"""

import argparse
import csv
import importlib
import json
import pathlib
import sys
import time
from collections import Counter
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from hard.wanted import brief, ended

ENGINES = {
    "mujoco": "hard_others.by_mujoco",
    "newton": "hard_others.by_newton",
    "pypbd": "hard_others.by_pypbd",
}
NOT_ASKED = {
    "genesis": "genesis-world 1.4.5 installs, but had not stepped one box after four minutes on the CPU at hand"
}
COLUMNS = ("engine", "version", "step", "case", "outcome", "wanted", "seconds")


def lines_of(engine: Any, steps: str | None) -> Any:
    """A line a case and step; `steps`: only with steps whose word begins so."""
    for word, dt in engine.STEPS.items():
        if steps and not word.startswith(steps):
            continue
        for name, function in engine.CASES.items():
            begun = time.perf_counter()
            wanted: Any = []
            try:
                wanted, flags = function(dt)
                outcome = ended(wanted, flags)
            except Exception as trouble:  # an error is loud
                outcome = f"flagged: {type(trouble).__name__}: {brief(trouble)}"
            yield {
                "engine": engine.NAME,
                "version": engine.VERSION,
                "step": word,
                "case": name,
                "outcome": outcome,
                "wanted": "; ".join(str(each) for each in wanted),
                "seconds": round(time.perf_counter() - begun, 2),
            }


def main() -> None:
    """Run all engines that can be imported."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--engines", default=",".join(ENGINES))
    parser.add_argument("--steps", help="only this step, like 1/60")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the results")
    options = parser.parse_args()
    lines: list[dict[str, Any]] = []
    missing: dict[str, str] = dict(NOT_ASKED)
    for name in options.engines.split(","):
        try:
            engine = importlib.import_module(ENGINES[name])
        except Exception as trouble:  # whatever keeps it from being imported
            missing[name] = f"{type(trouble).__name__}: {brief(trouble)}"
            print(f"{name} is left out: {missing[name]}", flush=True)
            continue
        for line in lines_of(engine, options.steps):
            lines.append(line)
            print(
                f"{line['engine']} | {line['step']} | {line['case']} | {line['outcome']} | {line['seconds']} s",
                flush=True,
            )
            if options.out:
                write(lines, missing, options.out)
    print(json.dumps(dict(Counter(f"{line['engine']} {line['outcome'].split(':')[0]}" for line in lines))))


def write(lines: list[dict[str, Any]], missing: dict[str, str], out: pathlib.Path) -> None:
    """hard_cases_others.csv and .json in a folder."""
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "hard_cases_others.csv", "w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        table.writerows(lines)
    (out / "hard_cases_others.json").write_text(json.dumps({"left_out": missing, "lines": lines}, indent=1) + "\n")


if __name__ == "__main__":
    main()
