"""The results of the three papers, drawn again beside theirs.  python benchmarks/papers.py [--quick] [--only A B C]

A: Benevolensky & Voroshilov 2009 (rows, joint grid, bricks, few iterations); B: notes on Mueller & Gross 2004 (springs,
assembled system, rotations); C: Wang, Xu & Hasegawa (groups). docs/papers.md says what came out, and what is wrong in
the papers. Times on a machine that others use are the least of several.
"""

import argparse
import pathlib
import sys

import jax

jax.config.update("jax_enable_x64", True)

sys.path.append(str(pathlib.Path(__file__).parent / "papers_parts"))

import draw  # noqa: E402
import groups  # noqa: E402
import rows  # noqa: E402
import springs  # noqa: E402
from machine import describe  # noqa: E402
from report import finish, save  # noqa: E402

PARTS = {"A": rows.measure, "B": springs.measure, "C": groups.measure}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repeats")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the figures and the plots")
    parser.add_argument("--only", nargs="+", choices=sorted(PARTS), default=sorted(PARTS), help="papers")
    given = parser.parse_args()
    figures = {"machine": describe()}
    for name in given.only:
        figures[name] = PARTS[name](given.quick)
        save("papers", figures, given.out)
    if given.out:
        draw.pictures(figures, given.out)
    finish("papers", figures, given.out)


if __name__ == "__main__":
    main()
