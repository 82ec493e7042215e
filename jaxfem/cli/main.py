"""The `jaxfem` command. Each subcommand is a module with `add(subparsers)` and `run(args) -> exit code`.

`add` makes the subcommand's parser and ends with `parser.set_defaults(run=run)`, with `kept=False` where what earlier
runs have compiled must not be used, `quick=True` where compiling takes more time than what is compiled. Exit codes: 0
done, 2 a mistake in the input, 3 a computation that failed, 130 interrupted.
"""

import argparse
import importlib
import importlib.util
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jaxfem
from jaxfem.cli import (
    bench,
    compare,
    completion,
    demo,
    fit,
    mesh_info,
    new,
    recording_info,
    sensitivity,
    simulate,
    sweep,
    view,
)
from jaxfem.cli.exits import INTERRUPTED, MISTAKE, leave_at_once
from jaxfem.cli.messages import error, warning
from jaxfem.cli.programs import keep_programs
from jaxfem.cli.threads import one_blas_thread
from jaxfem.cli.xla_flags import OLDER_EMITTER, ask_for
from jaxfem.io.live import LiveError
from jaxfem.io.plots import PlotError
from jaxfem.io.scene_files import SceneFileError
from jaxfem.materials.constants import MaterialError
from jaxfem.mesh import MeshError, MeshWarning

COMMANDS: tuple[Any, ...] = (
    new,
    simulate,
    view,
    compare,
    fit,
    sensitivity,
    sweep,
    demo,
    bench,
    mesh_info,
    recording_info,
    completion,
)
OWN_WARNINGS = (jaxfem.AccuracyWarning, MeshWarning)
USER_ERRORS = (
    SceneFileError,
    jaxfem.SceneError,
    MaterialError,
    MeshError,
    jaxfem.StepError,
    jaxfem.FitError,
    LiveError,
    jaxfem.SweepError,
    PlotError,
    ImportError,  # of --import, or an extra that is missing
    OSError,  # a file that is missing, or a folder that cannot be written
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (without the program's name; the process's own when None); returns the exit code.

    Compiled programs are kept between runs only for the process's own command line: a caller's process is his.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    given = {switch: switch in words for switch in ("--debug", "--no-cache")}  # taken anywhere on the line
    debug = given["--debug"]
    words, modules = _imports([word for word in words if word not in given])
    args = parser().parse_args(words)
    if argv is None:
        one_blas_thread()
        if args.quick:
            ask_for(OLDER_EMITTER)
        keep_programs(args.kept and not given["--no-cache"])
    code = _run(args, modules, debug)
    if argv is None and code == INTERRUPTED:
        leave_at_once(code)
    return code


def _run(args: argparse.Namespace, modules: list[str], debug: bool) -> int:
    """Run the command; what goes wrong is told on one line, or, to `debug`, raised."""
    with warnings.catch_warnings():
        for own in OWN_WARNINGS:
            warnings.simplefilter("always", own)
        _show_warnings_briefly()
        try:
            for module in modules:
                import_module(module)
            code: int = args.run(args)
            return code
        except USER_ERRORS as problem:
            if debug:
                raise
            error(_text(problem))
            return MISTAKE
        except KeyboardInterrupt:
            if debug:
                raise
            error("interrupted")
            return INTERRUPTED


def _imports(words: list[str]) -> tuple[list[str], list[str]]:
    """The words of the line without `--import MODULE`, taken anywhere on it, and those modules."""
    kept, modules, rest = list[str](), list[str](), iter(words)
    for word in rest:
        name, equals, value = word.partition("=")
        if name != "--import":
            kept.append(word)
        else:
            modules.append(value if equals else next(rest, ""))
    return kept, modules


def import_module(given: str) -> None:
    """Run a module or a Python file, so that the kinds it defines are known. ImportError says what is wrong.

    Modules beside the file, or in the working folder, can be imported too.
    """
    path = Path(given)
    if not given:
        raise ImportError("--import needs a module or a FILE.py of your own")
    if given.endswith(".py") and not path.is_file():
        raise FileNotFoundError(2, "no such file to --import", given)
    folder = str(path.resolve().parent if given.endswith(".py") else Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        _run_file(path) if given.endswith(".py") else importlib.import_module(given)
    except (TypeError, ValueError, SyntaxError, NameError, AttributeError) as problem:
        raise ImportError(f"{given}: {problem} (--debug shows where)") from problem


def _run_file(path: Path) -> None:
    """A file as a module of its name, which no other may have."""
    known = sys.modules.get(path.stem)
    if known is not None and getattr(known, "__file__", None) != str(path.resolve()):
        raise ImportError(f'{path} has the name of another module, "{path.stem}": rename the file')
    spec = importlib.util.spec_from_file_location(path.stem, path.resolve())
    assert spec is not None and spec.loader is not None
    sys.modules[path.stem] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)


def parser() -> argparse.ArgumentParser:
    """The parser with all subcommands."""
    made = argparse.ArgumentParser(prog="jaxfem", description="Simulate soft bodies. Units are SI throughout.")
    made.add_argument("--version", action="version", version=f"jaxfem {jaxfem.__version__}")
    made.add_argument("--debug", action="store_true", help="show where an error comes from")
    made.add_argument("--no-cache", action="store_true", help="keep no compiled programs, and use none (JAXFEM_CACHE)")
    made.add_argument(
        "--import", metavar="MODULE", help="a module or FILE.py of your own, run first: laws, joints, shapes it defines"
    )
    made.set_defaults(kept=True, quick=False)
    subparsers = made.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(subparsers)
    return made


def _text(problem: BaseException) -> str:
    """The error's message on one line; the system's own errors with their file."""
    if isinstance(problem, OSError) and problem.strerror:
        return f"{problem.filename}: {problem.strerror}" if problem.filename else problem.strerror
    return " ".join(str(problem).split())


def _show_warnings_briefly() -> None:
    """Until the surrounding catch_warnings ends: the package's warnings as a line, others as Python shows them.

    Of programs that cannot be kept (a disk that is full) the first is told, not each.
    """
    usual, lost = warnings.showwarning, list[Any]()

    def show(message: Any, category: type[Warning], *rest: Any, **more: Any) -> None:
        if issubclass(category, OWN_WARNINGS):
            warning(message)
        elif "persistent compilation cache" in str(message):
            if not lost:
                warning(f"{_text(message)}; going on without (said once)")
            lost.append(message)
        else:
            usual(message, category, *rest, **more)

    warnings.showwarning = show


if __name__ == "__main__":
    sys.exit(main())
