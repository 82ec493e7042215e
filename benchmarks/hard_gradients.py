"""Are gradients right where it is hard?  python benchmarks/hard_gradients.py [--only WORDS] [--out FOLDER]

Some of the nastiest scenes, each a scalar of one number: forward derivative, reverse derivative, and central
differences of several sizes in double precision. "right": it is that of the differences to 1e-6; "as near as
differences settle": to twice that to which three sizes in a row agree, which rounding makes more; where none agree to
1 %, forwards and backwards can only be compared with each other. Else `info` must say so ("flagged: ..."), as where
that from above is another than that from below, and where `info.residual` stays above the tolerance asked: values are
known to no more then. Or "SILENT".
Results: hard_gradients.json; the table is in docs/derivatives.md.
"""

import argparse
import itertools
import json
import pathlib
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxfem.cli.xla_flags import NO_OPTIMISATION, OLDER_EMITTER, ask_for

# Programs this small need no fast code: they compile in a third of the time.
ask_for(NO_OPTIMISATION, OLDER_EMITTER)

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from hard.gradient_cases import CASES, Problem  # noqa: E402
from machine import describe  # noqa: E402
from report import BEGUN, save  # noqa: E402

SIZES = (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)
"""Of central differences, as shares of the number's own scale."""
NEAR = 1e-6
RESIDUAL = 10.0
"""Times the tolerance asked: a residual above says that rounding ended a solve, and values are known to no more."""
KINK = 0.01
"""Share by which derivatives from above and below differ where there is none."""


class Differences(NamedTuple):
    """Central ones where three sizes in a row agree best, to the share `spread`; and one-sided ones of the smallest."""

    central: float
    spread: float
    above: float
    below: float


def differences(value: Callable[[float], float], at: float, scale: float) -> Differences:
    """Fourth-order central differences of several sizes, and first-order one-sided ones."""
    middle, found = value(at), []
    for size in SIZES:
        h = size * scale
        one, two = (value(at + k * h) - value(at - k * h) for k in (1, 2))
        found.append((8 * one - two) / (12 * h))
    steps = [(abs(b - a) / max(abs(b), 1e-300), b) for a, b in itertools.pairwise(found)]
    spread, central = min((max(one, two), middle_one) for (one, middle_one), (two, _) in itertools.pairwise(steps))
    h = SIZES[-2] * scale
    return Differences(central, spread, (value(at + h) - middle) / h, (middle - value(at - h)) / h)


def measured(problem: Problem) -> dict[str, Any]:
    """One line of the table."""
    at = problem.at
    run = jax.jit(problem.function)
    (_, info) = run(at)

    def both(x: Any) -> tuple[Any, Any]:
        value, push = jax.linearize(lambda x: problem.function(x)[0], x)
        return push(jnp.ones(())), jax.linear_transpose(lambda step: push(step), x)(jnp.ones_like(value))[0]

    forward, backward = map(float, jax.jit(both)(jnp.asarray(at)))
    known = differences(lambda x: float(run(x)[0]), at, problem.scale or abs(at))
    line = {"derivative": forward, **known._asdict()}
    line["off"] = abs(forward / known.central - 1) if known.central else abs(forward)
    line["reverse_off"] = abs(backward / forward - 1) if forward else abs(backward)
    line["status"] = sorted({int(each) for each in np.asarray(info.status).ravel()})
    line["weakly_active"] = int(np.asarray(info.weakly_active).sum())
    line["residual"], line["tolerance"] = float(np.asarray(info.residual).max()), problem.tolerance
    return line | {"outcome": outcome(line)}


def outcome(line: dict[str, Any]) -> str:
    """Right, flagged by name, or silent."""
    sides = abs(line["above"] - line["below"]) / max(abs(line["above"]), abs(line["below"]), 1e-300)
    off = max(line["off"], line["reverse_off"])
    if sides <= KINK and off <= NEAR:
        return "right"
    if line["status"] != [0]:
        return f"flagged: status {line['status'][-1]}"
    if line["weakly_active"]:
        return f"flagged: info.weakly_active = {line['weakly_active']}"
    if not np.isfinite(line["derivative"]):
        return "flagged: not finite"
    rounded = line["residual"] > RESIDUAL * line["tolerance"]
    if rounded and line["spread"] > NEAR and line["reverse_off"] <= NEAR:
        return f"flagged: info.residual = {line['residual']:.0e} where {line['tolerance']:.0e} was asked"
    if line["spread"] > KINK and line["reverse_off"] <= NEAR:
        return "forwards as backwards; differences do not settle"
    if sides > KINK:
        return "SILENT: other from above than from below"
    return "as near as differences settle" if off <= 2 * line["spread"] else "SILENT"


def main() -> None:
    """Run what is asked for, a line each; write as they come."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="comma-separated words, one of which is in a case's name")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the results")
    options = parser.parse_args()
    words = [word.strip() for word in options.only.split(",")]
    lines: list[dict[str, Any]] = []
    for name, (what, make) in CASES.items():
        if not any(word in name for word in words):
            continue
        begun = time.perf_counter()
        line = {"case": name, "derivative_of": what, **measured(make())}
        lines.append(line | {"seconds": round(time.perf_counter() - begun, 1)})
        print(
            f"| {name} | {what} | {line['derivative']:.6g} | {line['off']:.0e} | {line['spread']:.0e} | "
            f"{line['outcome']} |",
            flush=True,
        )
        figures = {"machine": describe(), "lines": lines, "benchmark_s": time.perf_counter() - BEGUN}
        save("hard_gradients", figures, options.out)
    print(json.dumps({line["case"]: line["outcome"] for line in lines}))


if __name__ == "__main__":
    main()
