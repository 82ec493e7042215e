"""`jaxfem simulate`: run a scene file, write frames, tables and plots as it goes."""

import argparse
import time
from pathlib import Path
from typing import Any

import jax

from jaxfem.cli.exits import FAILED, INTERRUPTED
from jaxfem.cli.messages import error, warning
from jaxfem.cli.running import Run, advance
from jaxfem.energies import with_account
from jaxfem.io.checkpoints import checkpoint_path, listed_frames, load_checkpoint
from jaxfem.io.export import FrameWriter
from jaxfem.io.plots import PlotError, plot_energies, plot_series, plot_shapes, require_matplotlib
from jaxfem.io.reading import read_frame, read_part
from jaxfem.io.scene_files import SceneFile, SceneFileError, load_scene
from jaxfem.mesh.topology import boundary_faces

PICTURES = ("energies.png", "shapes.png", "points.png")
FEW_POINTS = 2  # with more tracked points, three lines each would be too many


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser("simulate", help="run a scene file", description="Run a scene file.")
    parser.add_argument("file", metavar="FILE.toml", help="the scene: bodies, time step, solver, output")
    parser.add_argument("--out", metavar="FOLDER", help="where results go, instead of [output] folder")
    parser.add_argument("--steps", type=_positive, metavar="N", help="how many steps, instead of what [time] says")
    parser.add_argument("--no-plots", action="store_true", help="write no PNG files")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on where an earlier run of this file stopped")
    again.add_argument("--force", action="store_true", help="replace the results of an earlier run")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the scene; 0 at its end, 3 when a step fails, 130 when interrupted."""
    file = load_scene(args.file)
    if file.precision == "float64":
        jax.config.update("jax_enable_x64", True)
    folder = Path(args.out) if args.out else file.folder
    plots = not args.no_plots and _can_plot()
    index = folder / f"{file.source.stem}.pvd"
    _refuse_others(index)
    if not (args.resume or args.force):
        _refuse_old(index)
    model, params, state = file.build()
    if model.bodies:
        state = with_account(model, params, state)
    job = Run(model, params, state, file.dt, args.steps or file.steps, file.every, file.halvings)
    frames = 0
    if args.resume:
        job.state, job.done, frames = load_checkpoint(
            checkpoint_path(index), job.model, params, job.state, file.dt, job.mark
        )
    if job.done >= job.steps:
        raise SceneFileError(f"{index} is of {job.done} steps already: give a longer duration, or --steps, to go on")
    begun, looks = time.perf_counter(), _looks(file)
    kept = frames if job.done else 0
    with FrameWriter(folder, file.source.stem, model, params, file.points, file.tensors, kept=kept, **looks) as writer:
        advance(job, writer)
    wall = time.perf_counter() - begun
    for old in PICTURES:  # of an earlier run: they would not show this one
        (folder / old).unlink(missing_ok=True)
    pictures = _plots(writer) if plots and writer.saved else []
    if job.interrupted:
        error(f"interrupted after step {job.done} of {job.steps} (t = {job.done * job.dt:g} s)")
    if job.problem:
        error(job.problem)
    print(_summary(job, wall, writer, pictures, file))
    return INTERRUPTED if job.interrupted else FAILED if job.problem else 0


def _looks(file: SceneFile) -> dict[str, Any]:
    """What frames show beside the mesh."""
    return {"scene": file.scene, "dt": file.dt, "fields": file.fields}


def _refuse_old(index: Path) -> None:
    """Refuse to write over the results of an earlier run."""
    if index.is_file() and (frames := listed_frames(index)):
        raise SceneFileError(
            f"{index} lists {len(frames)} frames of an earlier run, to t = {frames[-1][0]:g} s: give --resume to go on "
            "from there, --force to replace them, or --out FOLDER for another place"
        )


def _refuse_others(index: Path) -> None:
    """Refuse a folder that holds the results of another scene: both would write the same tables and pictures."""
    for other in sorted(index.parent.glob("*.pvd")):
        if other != index and checkpoint_path(other).is_file():
            raise SceneFileError(
                f"{index.parent} holds the results of another scene, {other.name}, whose tables this run would "
                "replace: give --out FOLDER for another place, or remove the folder"
            )


def _summary(job: Run, wall: float, writer: FrameWriter, pictures: list[Path], file: SceneFile) -> str:
    compiling, each = job.timing()
    pace = f"compiling {compiling:.1f} s" + (f", then {each * 1e3:.3g} ms a step" if each else " and the first steps")
    names = [path.name for path in writer.files()] + [path.name for path in pictures]
    frames = f"{len(writer.saved)} frame" + ("" if len(writer.saved) == 1 else "s")
    model = writer.model
    return (
        f'solver "{model.method.name}": {model.choice.reason}\n'
        f"{file.source.name}: {job.done} of {job.steps} steps, to t = {job.done * job.dt:g} s, in {wall:.1f} s"
        f" ({pace})\nwrote {frames} and {', '.join(names)} in {writer.folder}"
    )


def _can_plot() -> bool:
    try:
        require_matplotlib()
    except PlotError as problem:
        warning(f"{problem}; going on without them")
        return False
    return True


def _plots(writer: FrameWriter) -> list[Path]:
    """Energies over time, the first, middle and last shape, and how far tracked points moved."""
    made = [plot_energies(writer.folder / "energies.png", writer.row_times, writer.energies)]
    shapes = _shapes(writer)
    made += [] if shapes is None else [shapes]
    moved = {name: path - path[0] for name, path in writer.paths.items()}
    if moved:
        lines = {f"{name} {axis}": path[:, i] for name, path in moved.items() for i, axis in enumerate("xyz")}
        if len(moved) > FEW_POINTS:
            lines = {name: (path**2).sum(axis=1) ** 0.5 for name, path in moved.items()}
        made.append(plot_series(writer.folder / "points.png", writer.row_times, lines, "displacement", "m"))
    return made


def _shapes(writer: FrameWriter) -> Path | None:
    """The first, middle and last shape, with rigid bodies; None where there is nothing to draw."""
    chosen = dict.fromkeys([0, (len(writer.saved) - 1) // 2, len(writer.saved) - 1])
    saved = [writer.saved[i] for i in chosen]
    titles = [f"t = {each.time:.4g} s" for each in saved]
    parts = [read_part(each.parts["rigid"]) for each in saved if "rigid" in each.parts]
    others = {title: part.points[part.cells] for title, part in zip(titles, parts, strict=False)}
    if not writer.model.bodies and not others:
        return None
    if not writer.model.bodies:  # coloured by how far they moved, as soft ones are
        surface, rest = parts[0].cells, parts[0].points - parts[0].nodal["displacement"]
        places = {title: part.points for title, part in zip(titles, parts, strict=True)}
        return plot_shapes(writer.folder / "shapes.png", surface, places, rest)
    frames = [read_frame(each.path, each.time) for each in saved]
    places = {title: frame.positions for title, frame in zip(titles, frames, strict=True)}
    surface = boundary_faces(frames[0].cells)[0]
    return plot_shapes(writer.folder / "shapes.png", surface, places, writer.model.rest, others)


def _positive(text: str) -> int:
    value = int(text) if text.strip().isdigit() else 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return value
