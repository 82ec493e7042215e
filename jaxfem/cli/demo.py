"""`jaxfem demo`: a scene, a recording of its own making, and the fit that finds the material again."""

import argparse
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxfem.cli import fit, simulate
from jaxfem.cli.exits import INTERRUPTED
from jaxfem.cli.messages import error
from jaxfem.fitting import FitResult, Recording, attach, marker_positions, write_recording
from jaxfem.io.examples import beam_scene
from jaxfem.io.fit_files import load_fit
from jaxfem.io.scene_files import SceneFileError, load_scene
from jaxfem.stepping import rollout

TRUE = {"young": 2.6e5, "poisson": 0.4, "damping": 4e-3}
START = {"young": 8e6, "poisson": 0.2, "damping": 4e-4}  # the stiffness thirty times off
STEP, STEPS = 1e-2, 80
STILL = 30  # samples before the release
NOISE = 3e-5  # m; good motion capture
MARKERS = {
    "tip_top": (0.1, 0.015, 0.035),
    "tip_left": (0.1, -0.005, 0.02),
    "tip_right": (0.1, 0.035, 0.005),
    "middle_top": (0.05, 0.015, 0.035),
    "middle_side": (0.05, 0.035, 0.015),
    "base_side": (0.02, 0.035, 0.015),
}
_FIT = """\
# Recovers the material of the beam in beam_start.toml from recording.csv. Run it with: jaxfem fit fit.toml

scene = "beam_start.toml"       # the body, its supports, and where the search starts
recording = "recording.csv"     # time_s, then NAME_x_m, NAME_y_m, NAME_z_m of each marker; blank cells are missing

[markers]                       # where each marker sits on the undeformed body, m; a little off the surface is fine
{markers}

[fit]
parameters = ["young", "poisson", "damping"]    # also: "density"; "delay", of the release behind its row
frame = "none"                  # recorded in the body's frame; "rest" or "all" for a camera's own
compare = "displacement"        # since the release; or "position"
release = "auto"                # found: the body is still at first; or a time in s
# end = "settled"               # or a time in s; without it, to the end of the recording
# substeps = 2                  # time steps a sample; without it, the scene's time step
# [fit.bounds]
# young = [1e4, 1e8]            # Pa

[output]
folder = "fitted"
"""


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "demo",
        help="write an example, simulate it and fit it",
        description="Write an example scene, simulate it, and recover its material from a recording with noise.",
    )
    parser.add_argument("--out", metavar="FOLDER", default="demo", help="where everything goes (default: demo)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise in the recording")
    parser.add_argument("--force", action="store_true", help="replace files that were edited since the demo wrote them")
    parser.set_defaults(run=run, cells=(6, 2, 2), steps=STEPS, quick=True)


def run(args: argparse.Namespace) -> int:
    """Write, simulate, fit, compare; 0 when done."""
    begun = time.perf_counter()
    jax.config.update("jax_enable_x64", True)
    folder = Path(args.out)
    folder.mkdir(parents=True, exist_ok=True)
    inputs = _inputs(args.cells, args.steps)
    if not args.force:
        _refuse_edited(folder, inputs)
    for name, text in inputs.items():
        (folder / name).write_text(text, encoding="utf-8")
    scene = folder / "beam.toml"
    print("1. simulating the beam with the true material", flush=True)
    simulation = argparse.Namespace(file=str(scene), out=str(folder / "simulated"), steps=None, no_plots=False)
    simulation.force, simulation.resume = True, False
    code = simulate.run(simulation)
    if code:
        return code
    print("\n2. recording six markers on it, with noise of 0.03 mm", flush=True)
    _record(folder, scene, args.seed)
    print("\n3. fitting, from a start thirty times too stiff", flush=True)
    result, _, code = fit.fitted(load_fit(folder / "fit.toml"), folder / "fitted")
    if code == INTERRUPTED:
        error("interrupted; the best so far is written")
        return INTERRUPTED
    print(_verdict(folder, result, time.perf_counter() - begun))
    return 0


def _inputs(cells: Any, steps: int) -> dict[str, str]:
    """beam.toml (the truth), beam_start.toml (where the fit starts) and fit.toml: name -> text."""
    made = {}
    for name, values in (("beam", TRUE), ("beam_start", START)):
        material = values["young"], values["poisson"], values["damping"]
        made[f"{name}.toml"] = beam_scene(*material, cells, step=STEP, steps=steps, every=2)
    markers = "\n".join(f"{name} = {list(place)}" for name, place in MARKERS.items())
    return made | {"fit.toml": _FIT.format(markers=markers)}


def _refuse_edited(folder: Path, inputs: dict[str, str]) -> None:
    """Refuse to write over files that someone has changed."""
    edited = [
        name
        for name, text in inputs.items()
        if (path := folder / name).is_file() and path.read_text(encoding="utf-8") != text
    ]
    if edited:
        raise SceneFileError(
            f"{' and '.join(edited)} in {folder} differ from what the demo writes (were they edited?): run them with "
            "`jaxfem simulate` or `jaxfem fit`, or give --force to replace them, or --out FOLDER for another place"
        )


def _record(folder: Path, scene: Path, seed: int) -> None:
    """The markers' places, still at first and then at every step of the true motion, with noise and a few samples
    lost."""
    file = load_scene(scene)
    model, params, state = file.build()
    states, _ = rollout(model, params, state, file.dt, file.steps)
    markers = attach(model, MARKERS)
    still = np.asarray(marker_positions(markers, state.positions), np.float64)
    moving = np.asarray(marker_positions(markers, states.positions), np.float64)
    clean = np.concatenate([np.broadcast_to(still, (STILL, *still.shape)), moving])
    random = np.random.default_rng(seed)
    noisy = clean + NOISE * random.normal(size=clean.shape)
    noisy[random.random(noisy.shape[:2]) < 0.02] = np.nan
    write_recording(folder / "recording.csv", Recording(np.arange(len(noisy)) * file.dt, noisy, markers.names))


def _verdict(folder: Path, result: FitResult, seconds: float) -> str:
    lines = ["", f"{'':<11}{'started at':>12}{'true':>12}{'fitted':>12}"]
    for name, value in result.values.items():
        true, bar = TRUE[name], result.standard_errors[name]
        lines.append(f"{name:<11}{START[name]:>12.4g}{true:>12.4g}{value:>12.4g} +- {bar:.2g}")
    lines += [f"note: {text}" for text in result.warnings]
    lines.append(
        "note: the recording was simulated with the fit's own step and mesh, so what these do is in both; a filmed"
    )
    lines.append("      body has none of it, which is what notes on the time step's damping and the mesh above warn of")
    lines += [
        "",
        f"All in {seconds:.0f} s. Look at, in {folder}:",
        "  fitted/report.html                      everything about the fit on one page; opens in any browser",
        "  fitted/measured_against_simulated.png   the recording and the fitted simulation",
        "  fitted/loss.png                         how the search went",
        "  fitted/summary.txt, fitted.json, residuals.csv",
        "  simulated/                              frames for ParaView, plots and tables of the true motion",
        "Next: change the material in beam.toml and run `jaxfem simulate`; or put your own mesh in beam_start.toml,",
        "your own markers and recording in fit.toml, and run `jaxfem fit`.",
    ]
    return "\n".join(lines)
