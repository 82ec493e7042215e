"""The loop of `jaxfem simulate`: chunks of steps through one compiled program, watched for failures."""

import dataclasses
import time
from typing import Any

import jax
import numpy as np

from jaxfem.cli.messages import warning
from jaxfem.cli.progress import Progress
from jaxfem.io.export import FrameWriter
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.solvers import Status, describe
from jaxfem.stepping import rollout, step


@dataclasses.dataclass
class Run:
    """A run in progress: after `done` of `steps` steps of `dt` [s] it is at `state`; a frame each `every` steps.

    `problem` says why it stopped early; `chunks` holds (steps, seconds) of each call.
    """

    model: Model
    params: Params
    state: State
    dt: float
    steps: int
    every: int
    done: int = 0
    problem: str = ""
    interrupted: bool = False
    warned: bool = False
    chunks: list[tuple[int, float]] = dataclasses.field(default_factory=list)

    def timing(self) -> tuple[float, float]:
        """Seconds spent compiling (with the first steps, where no others were taken), and a step (0: not known).

        The first chunk of each length compiles; the others tell how long a step takes.
        """
        lengths = [count for count, _ in self.chunks]
        first = [lengths.index(count) == i for i, count in enumerate(lengths)]
        later = [chunk for chunk, fresh in zip(self.chunks, first, strict=True) if not fresh]
        taken = sum(count for count, _ in later)
        each = sum(seconds for _, seconds in later) / taken if taken else 0.0
        fresh = [seconds - count * each for (count, seconds), new in zip(self.chunks, first, strict=True) if new]
        return max(0.0, sum(fresh)), each


def advance(run: Run, writer: FrameWriter) -> None:
    """Take all steps and write the frames; an interruption or a failed step ends it early and is noted in `run`."""
    try:
        with Progress(run.steps) as bar:
            writer.write(run.state)
            while run.done < run.steps and not run.problem:
                _chunk(run, writer, bar)
    except KeyboardInterrupt:
        run.interrupted = True


def _chunk(run: Run, writer: FrameWriter, bar: Progress) -> None:
    count = min(run.every, run.steps - run.done)
    begun = time.perf_counter()
    states, infos = jax.block_until_ready(rollout(run.model, run.params, run.state, run.dt, count, every=count))
    run.chunks.append((count, time.perf_counter() - begun))
    # Through the host, where the frame is written anyway: on the device each shape would take a program of its own.
    following, info = jax.tree.map(lambda leaf: np.asarray(leaf)[0], (states, infos))
    if _failed(following, info):
        taken, following, info = _first_failure(run, count, following, info)
        run.problem = _problem(run, run.done + taken, following, info)
        run.done += taken - 1
        return
    if int(info.inverted) and not run.warned:
        bar.clear()
        warning(_inversion(run, int(info.inverted), count, following))
        run.warned = True
    writer.write(following)
    run.state, run.done = following, run.done + count
    bar.advance(count, f"t = {run.done * run.dt:.4g} s")


def _failed(state: State, info: StepInfo) -> bool:
    numbers = [state.positions, state.velocities]
    if state.rigid is not None:
        numbers += [state.rigid.positions, state.rigid.velocities, state.rigid.angular_velocities]
    return bool(info.status != 0) or not all(np.isfinite(each).all() for each in numbers)


def _first_failure(run: Run, count: int, end: State, info: StepInfo) -> tuple[int, State, StepInfo]:
    """Which step of a failed chunk failed (from 1), with its state and info: the chunk again, one step at a time."""
    if count == 1:
        return 1, end, info
    state = run.state
    for taken in range(1, count + 1):
        state, each = step(run.model, run.params, state, run.dt)
        if _failed(state, each):
            return taken, state, each
    return count, end, info


def _problem(run: Run, number: int, state: State, info: StepInfo) -> str:
    """The step that failed, its time, the body to look at, and the remedy."""
    velocities, places = np.asarray(state.velocities), np.asarray(state.positions)
    names = [run.model.bodies[number] for number in np.asarray(run.model.node_body)]
    if state.rigid is not None and run.model.rigid is not None:
        velocities = np.concatenate([velocities, np.asarray(state.rigid.velocities)])
        places = np.concatenate([places, np.asarray(state.rigid.positions)])
        names += run.model.rigid.names
    speeds = np.linalg.norm(velocities, axis=1)
    lost = ~np.isfinite(speeds) | ~np.isfinite(places).all(axis=1)
    name = names[np.argmax(lost) if lost.any() else np.argmax(speeds)]
    what = "not finite any more" if lost.any() else f"the fastest, {speeds.max():.3g} m/s"
    status = int(info.status) or int(Status.NOT_FINITE)
    return f'step {number} (t = {number * run.dt:.6g} s) failed; body "{name}" is {what}. Its solve: {describe(status)}'


def _inversion(run: Run, count: int, steps: int, following: State) -> str:
    """Says which bodies have elements inside out, at the end of the chunk or at its start."""
    names: dict[str, Any] = {}
    for state in (following, run.state):
        places = np.asarray(state.positions)[np.asarray(run.model.elements.cells)]
        inside_out = np.linalg.det(places[:, 1:] - places[:, :1]) <= 0
        names = dict.fromkeys(run.model.bodies[i] for i in np.unique(np.asarray(run.model.elements.body)[inside_out]))
        if names:
            break
    bodies = " and ".join(f'"{name}"' for name in names) or "a body, for a moment"
    elements = "an element is" if count == 1 else f"{count} elements are"
    when = f"between steps {run.done} and {run.done + steps}"
    remedy = "take a smaller time step, a finer mesh or gentler loads (said once)"
    return f"{elements} turned inside out in {bodies} {when}: {remedy}"
