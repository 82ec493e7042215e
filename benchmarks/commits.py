"""Did a step get slower between two commits?  python benchmarks/commits.py OLD NEW [--only WORDS] [--out FOLDER]

OLD and NEW: commits of this repository, or folders with checkouts of it. Each has a process of its own; the two take
turns call by call, so that what else the machine does falls on both. `--only`: cases whose names hold one of the
comma-separated words. Figures: median wall and processor time of a call after warm-up, iterations of all its steps and
its steps that failed, of both, and the ratio of wall times, new over old. The scenes are those of the benchmarks here.
"""

import argparse
import contextlib
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

HERE = pathlib.Path(__file__).resolve().parent
Call = Callable[[], Any]
Fields = tuple[float, float, int, int]


def cases() -> dict[str, Callable[[], Call]]:
    """Name -> what makes a case's call, which gives (states, info) or a number."""
    import brick
    import gradient
    import jax.numpy as jnp
    import joint_grid
    import ragdoll
    import scenes
    import soft_cube
    import stack

    import jaxfem as jf

    def rolled(built: Any, dt: float, steps: int) -> Call:
        model, params, state = built
        return lambda: jf.rollout(model, params, state, dt, steps)

    def doll(solver: str) -> Call:
        built = jf.build(ragdoll.doll(), dtype=jnp.float32, tolerance=1e-4, solver=solver, max_iterations=5000)
        return rolled(built, 1e-2, 60)

    both = {"float32": jnp.float32, "float64": jnp.float64}
    found: dict[str, Callable[[], Call]] = {}
    for word, dtype in both.items():
        tight = 1e-6 if word == "float64" else 1e-5
        found |= {
            f"brick, {word}": lambda d=dtype: rolled(scenes.brick(d), brick.DT, brick.STEPS),
            f"brick, all rows, {word}": lambda d=dtype: rolled(scenes.brick(d, "mprgp"), brick.DT, 2),
            f"soft cube, {word}": lambda d=dtype: rolled(soft_cube.cube(d), soft_cube.DT, 60),
            f"fifty steps, {word}": lambda d=dtype, t=tight: gradient.calls(d, t)[0],
            f"their gradient, {word}": lambda d=dtype, t=tight: gradient.calls(d, t)[1],
            f"stack turned, {word}": lambda w=word: rolled(stack.stack(10, 0.002, w), stack.DT, 60),
        }
    found |= {
        "stack straight, float64": lambda: rolled(stack.stack(0, 0.002, "float64"), stack.DT, 60),
        "stack aligned, float64": lambda: rolled(stack.stack(0, 0.0, "float64"), stack.DT, 60),
        "joint grid, float32": lambda: rolled(joint_grid.grid(jnp.float32), joint_grid.DT, 30),
        "joint grid, all rows, float32": lambda: rolled(joint_grid.grid(jnp.float32, solver="mprgp"), joint_grid.DT, 5),
        "ragdoll, float32": lambda: doll("auto"),
        "ragdoll, condensed, float32": lambda: doll("condensed"),
    }
    return found


def serve() -> None:
    """A process of one checkout: makes the case that a line names, and calls it at each empty line."""
    import jax

    jax.config.update("jax_enable_x64", True)
    known, call = cases(), lambda: None
    for line in sys.stdin:
        if name := line.strip():
            call = known[name]()
            jax.block_until_ready(call())
        wall, spent = time.perf_counter(), time.process_time()
        found = jax.block_until_ready(call())
        figures = time.perf_counter() - wall, time.process_time() - spent, *_steps(found)
        print(json.dumps(figures), flush=True)


def _steps(found: Any) -> tuple[int, int]:
    """Iterations and failed steps of a run; none where the call gives something else."""
    info = found[1] if isinstance(found, tuple) and hasattr(found[1], "iterations") else None
    return (0, 0) if info is None else (int(info.iterations.sum()), int((info.status != 0).sum()))


class Side:
    """One of the two checkouts, in a process of its own."""

    def __init__(self, folder: pathlib.Path):
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(HERE)])}
        command = [sys.executable, str(HERE / "commits.py"), "--serve"]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=folder
        )

    def ask(self, name: str = "") -> Fields:
        """Make a case, or call the one that was made."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(name + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"a process ended with {self.process.wait()} at {name or 'a call'}")
        return tuple(json.loads(line))  # type: ignore[return-value]


def compared(sides: tuple[Side, Side], name: str, repeats: int) -> dict[str, Any]:
    """Figures of both sides for one case."""
    told = [side.ask(name) for side in sides]
    calls: list[list[Fields]] = [[], []]
    for _ in range(repeats):
        for own, side in zip(calls, sides, strict=True):
            own.append(side.ask())
    line: dict[str, Any] = {"case": name}
    for word, own, first in zip(("old", "new"), calls, told, strict=True):
        wall, spent = (1e3 * statistics.median(each[k] for each in own) for k in (0, 1))
        line |= {f"{word}_ms": wall, f"{word}_processor_ms": spent}
        line |= {f"{word}_iterations": first[2], f"{word}_failed": first[3]}
    return line | {"ratio": line["new_ms"] / line["old_ms"]}


@contextlib.contextmanager
def checkout(given: str) -> Iterator[pathlib.Path]:
    """The folder given, or a working tree of the commit given."""
    if (pathlib.Path(given) / "jaxfem").is_dir():
        yield pathlib.Path(given).resolve()
        return
    with tempfile.TemporaryDirectory() as folder:
        git = ["git", "-C", str(HERE.parent), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", f"{folder}/tree", given], check=True)
        try:
            yield pathlib.Path(folder) / "tree"
        finally:
            subprocess.run([*git, "remove", "--force", f"{folder}/tree"], check=True)


def picture(path: pathlib.Path, lines: list[dict[str, Any]]) -> None:
    """Ratios as bars, one and 1.05 marked."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 0.35 * len(lines) + 1), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.barh([line["case"] for line in lines], [line["ratio"] for line in lines], color="0.6")
    axes.invert_yaxis()
    axes.axvline(1.0, color="black", lw=1)
    axes.axvline(1.05, color="tab:red", lw=1)
    axes.set_xlabel("wall time of a call, new over old")
    figure.savefig(path)


def main() -> None:
    if sys.argv[1:] == ["--serve"]:
        serve()
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", help="a commit, or a folder with a checkout")
    parser.add_argument("new", help="another")
    parser.add_argument("--only", default="", help="words, comma-separated, of which a case's name holds one")
    parser.add_argument("--repeats", type=int, default=7, help="calls of each side (7)")
    parser.add_argument("--out", type=pathlib.Path, help="folder for commits.json and commits.png")
    options = parser.parse_args()
    words, lines = [word.strip() for word in options.only.split(",")], []
    from machine import describe
    from report import finish, save

    names = [name for name in cases() if any(word in name for word in words)]
    with checkout(options.old) as old, checkout(options.new) as new:
        sides = Side(old), Side(new)
        for name in names:
            lines.append(compared(sides, name, options.repeats))
            print(f"{name}: {lines[-1]['ratio']:.3f}", file=sys.stderr, flush=True)
            save("commits", {"machine": describe(), "lines": lines}, options.out)
    if options.out:
        picture(options.out / "commits.png", lines)
    finish("commits", {"machine": describe(), "old": options.old, "new": options.new, "lines": lines}, options.out)


if __name__ == "__main__":
    main()
