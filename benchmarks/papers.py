"""The results of the three papers, drawn again beside theirs.  python benchmarks/papers.py [--quick] [--only A C.times]

A: Benevolensky & Voroshilov 2009 (rows, joint grid, bricks, few iterations); B: notes on Mueller & Gross 2004 (springs,
assembled system, rotations); C: Wang, Xu & Hasegawa (groups). docs/papers.md says what came out, and what is wrong in
the papers. Times on a machine that others use are the least of several. Parts that are not run again stay in the
folder as they were; those run with --quick are listed.
"""

import argparse
import json
import pathlib
import sys
import warnings
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

sys.path.append(str(pathlib.Path(__file__).parent / "papers_parts"))

import draw  # noqa: E402
import groups  # noqa: E402
import rows  # noqa: E402
import springs  # noqa: E402
from machine import describe  # noqa: E402
from report import finish, save  # noqa: E402

PARTS = {"A": rows.PARTS, "B": springs.PARTS, "C": groups.PARTS}
NAMES = [f"{paper}.{part}" for paper, parts in PARTS.items() for part in parts]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repeats")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the figures and the plots")
    parser.add_argument(
        "--only", nargs="+", choices=[*PARTS, *NAMES], default=[*PARTS], help="papers, or parts of them"
    )
    given = parser.parse_args()
    figures = _known(given.out) | {"machine": describe()}
    for name in [each for each in NAMES if each in given.only or each[0] in given.only]:
        paper, part = name.split(".")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # springs' Poisson's ratio, coarse meshes: known here
            figures.setdefault(paper, {})[part] = PARTS[paper][part](given.quick)
        figures["quick"] = sorted({*figures.get("quick", ()), name} - (set() if given.quick else {name}))
        save("papers", figures, given.out)
    if given.out:
        draw.pictures(figures, given.out)
    finish("papers", figures, given.out)


def _known(folder: pathlib.Path | None) -> dict[str, Any]:
    """The figures of earlier runs."""
    path = folder / "papers.json" if folder else None
    return json.loads(path.read_text()) if path and path.is_file() else {}


if __name__ == "__main__":
    main()
