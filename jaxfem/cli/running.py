"""The loop of `jaxfem simulate`: chunks of steps through one compiled program, watched for failures."""

import dataclasses
import math
import time
from typing import Any

import jax
import numpy as np

from jaxfem.cli.messages import warning
from jaxfem.cli.progress import Progress
from jaxfem.diagnose import diagnose, words
from jaxfem.io.checkpoints import checkpoint_path, save_checkpoint
from jaxfem.io.export import FrameWriter
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.solvers import Status
from jaxfem.stepping import rollout


@dataclasses.dataclass
class Run:
    """A run in progress: after `done` of `steps` steps of `dt` [s] it is at `state`; a frame each `every` steps.
    A step that fails is taken again in halves `halvings` times.

    `problem` says why it stopped early; `chunks` holds (steps, seconds) of each call.
    """

    model: Model
    params: Params
    state: State
    dt: float
    steps: int
    every: int
    halvings: int = 0
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
        with Progress(run.steps, done=run.done) as bar:
            if not run.done:
                _written(run, writer)
            while run.done < run.steps and not run.problem:
                _chunk(run, writer, bar)
    except KeyboardInterrupt:
        run.interrupted = True


def _chunk(run: Run, writer: FrameWriter, bar: Progress) -> None:
    count = min(run.every, run.steps - run.done)
    fresh = count not in [steps for steps, _ in run.chunks]
    if fresh:
        bar.compiling()
    begun = time.perf_counter()
    made = rollout(
        run.model,
        run.params,
        run.state,
        run.dt,
        count,
        every=count,
        on_failure="halve" if run.halvings else "stop",
        halvings=run.halvings or 1,
    )
    states, infos = jax.block_until_ready(made)
    run.chunks.append((count, time.perf_counter() - begun))
    # Through the host, where the frame is written anyway: on the device each shape would take a program of its own.
    following, info = jax.tree.map(lambda leaf: np.asarray(leaf)[0], (states, infos))
    if _failed(following, info):
        # The rollout has stopped there: its time says at which step.
        taken = max(1, math.ceil((float(following.time) - float(run.state.time)) / run.dt - 1e-3))
        run.problem = _problem(run, run.done + min(taken, count), following, info)
        run.done += min(taken, count) - 1
        return
    if int(info.inverted) and not run.warned:
        bar.clear()
        warning(_inversion(run, int(info.inverted), count, following))
        run.warned = True
    run.state, run.done = following, run.done + count
    _written(run, writer)
    bar.advance(count, f"t = {run.done * run.dt:.4g} s", compiled=fresh)


def _written(run: Run, writer: FrameWriter) -> None:
    """A frame of the state, and the state itself, from which a run can go on."""
    writer.write(run.state)
    save_checkpoint(checkpoint_path(writer.index), run.state, run.done, run.dt, len(writer.saved))


def _failed(state: State, info: StepInfo) -> bool:
    numbers = [state.positions, state.velocities]
    if state.rigid is not None:
        numbers += [state.rigid.positions, state.rigid.velocities, state.rigid.angular_velocities]
    return bool(info.status != 0) or not all(np.isfinite(each).all() for each in numbers)


def _problem(run: Run, number: int, state: State, info: StepInfo) -> str:
    """The step that failed and its time, then what `diagnose` finds: the body, joint or contact, and what to do."""
    found = diagnose(run.model, run.params, state, info)
    word = found.status if found.status else Status.NOT_FINITE
    retried = f", also in steps of {run.dt / 2**run.halvings:.3g} s" if run.halvings else ""
    head = f"step {number} of {run.steps} (t = {number * run.dt:.6g} s) failed{retried}: {words(word)}"
    return "\n".join([head, *found.text.splitlines()[1:]])


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
