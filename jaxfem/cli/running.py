"""The loop of `jaxfem simulate`: chunks of frames through one compiled program, watched for failures."""

import dataclasses
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.cli.messages import warning
from jaxfem.cli.progress import Progress
from jaxfem.diagnose import beyond, diagnose, words
from jaxfem.io.checkpoints import checkpoint_path, save_checkpoint, scene_mark
from jaxfem.io.export import FrameWriter
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import on_host
from jaxfem.solvers import Status
from jaxfem.stepping.frames import Seen, Watch, begin, frames

PACE = 0.5  # s that a call may take: an interruption is heard, and what was reached is written, between calls
GROWTH = 4  # of the number of steps from call to call
ROOM = 64e6  # bytes of frames that wait to be written
FIRST = 256  # steps that a first call takes at most, when nobody knows yet how long one lasts
MOST_ROWS = 1 << 16  # steps a call, which leave a row each
MOST = 64  # frames a call: what a call costs beside its steps is nothing by then


@dataclasses.dataclass
class Run:
    """A run in progress: after `done` of `steps` steps of `dt` [s] it is at `state`; a frame each `every` steps.
    A step that fails is taken again in halves `halvings` times.

    `problem` says why it stopped early; `chunks` holds (steps, seconds) of each call, of at most `most` frames; the
    last frame was written after `framed` steps; `warned`: of what it has been.
    """

    model: Model
    params: Params
    state: State
    dt: float
    steps: int
    every: int
    halvings: int = 0
    done: int = 0
    framed: int = 0
    problem: str = ""
    interrupted: bool = False
    warned: set[str] = dataclasses.field(default_factory=set)
    chunks: list[tuple[int, float]] = dataclasses.field(default_factory=list)
    most: int = 1
    mark: str = ""

    def __post_init__(self) -> None:
        """What serves all steps is made here, once, from the state at the start: also for a run that goes on later."""
        if self.model is not None:
            self.mark = scene_mark(self.model, self.params)
            self.model, state = begin(self.model, self.params, self.state, self.dt)
            self.state = on_host(state)  # as later ones are: else a program more
            size = sum(leaf.nbytes for leaf in jax.tree.leaves(self.state))
            self.every = min(self.every, max(1, self.steps))
            most = min(MOST, ROOM // max(size, 1), MOST_ROWS // self.every, -(-self.steps // self.every))
            self.most = max(1, int(most))

    def timing(self) -> tuple[float, float]:
        """Seconds spent compiling (with the first steps, where no others were taken), and a step (0: not known).

        The first chunk compiles; the others tell how long a step takes.
        """
        if not self.chunks:
            return 0.0, 0.0
        (count, seconds), *later = self.chunks
        taken = sum(steps for steps, _ in later)
        each = sum(spent for _, spent in later) / taken if taken else 0.0
        return max(0.0, seconds - count * each), each


def advance(run: Run, writer: FrameWriter) -> None:
    """Take all steps and write the frames; an interruption or a failed step ends it early and is noted in `run`."""
    try:
        with Progress(run.steps, done=run.done) as bar:
            run.framed = run.done
            if not run.done:
                _written(run, writer)
            while run.done < run.steps and not run.problem:
                _chunk(run, writer, bar)
    except KeyboardInterrupt:
        run.interrupted = True
    if writer.saved and not writer.listed:
        writer.list_frames()
        _checked(run, writer)


def _chunk(run: Run, writer: FrameWriter, bar: Progress) -> None:
    """Frames by one call, as many as `PACE` allows, or a part of one that takes longer; the last may be shorter."""
    every, count = _next(run)
    fresh = not run.chunks
    if fresh:
        bar.compiling()
    begun = time.perf_counter()
    options: dict[str, Any] = {"most": run.most, "halvings": run.halvings}
    points = writer.points
    options |= {
        "watch": Watch(jnp.asarray(points.nodes), jnp.asarray(points.weights, run.model.rest.dtype)),
        "rows": _room(run),
    }
    made = jax.block_until_ready(frames(run.model, run.params, run.state, run.dt, count, every, **options))
    run.chunks.append((count * every, time.perf_counter() - begun))
    # Through the host, where the frame is written anyway: on the device each shape would take a program of its own.
    rows = on_host(made)
    for number in range(count):
        following, info = jax.tree.map(lambda leaf, at=number: leaf[at], rows[:2])
        steps = [
            jax.tree.map(lambda leaf, at=at: leaf[at], rows[2]) for at in range(number * every, (number + 1) * every)
        ]
        _frame(run, writer, bar, following, info, steps)
        if run.problem:
            return
        bar.advance(every, f"t = {run.done * run.dt:.4g} s", compiled=fresh)


def _next(run: Run) -> tuple[int, int]:
    """Steps a frame and frames of the next call."""
    allowed, left = _affordable(run), run.steps - run.done
    due = min(run.framed + run.every - run.done, left)  # to the next frame
    if due < run.every or allowed < run.every:
        return min(due, allowed), 1
    return run.every, min(allowed // run.every, run.most, left // run.every)


def _affordable(run: Run) -> int:
    """How many steps the next call takes: by how long the last took, which compiled nothing."""
    if len(run.chunks) < 2:
        return min(run.every, FIRST)
    steps, seconds = run.chunks[-1]
    most = min(GROWTH * steps, MOST_ROWS)
    return int(np.clip(PACE / max(seconds, 1e-9) * steps, 1, most))


def _room(run: Run) -> int:
    """Rows of steps that a call's arrays hold: a power of two, so that other frames a run seldom need a new program."""
    return 1 << (min(run.most * run.every, MOST_ROWS) - 1).bit_length()


def _frame(run: Run, writer: FrameWriter, bar: Progress, following: State, info: StepInfo, steps: list[Seen]) -> None:
    """Take note of a frame and the `steps` to it from the last: written, or the end of the run."""
    count = len(steps)
    if _failed(following, info):
        # The run has stopped there: all later rows repeat the one of the step that failed.
        before = next((at for at, each in enumerate(steps) if each.time == following.time), count - 1)
        run.problem = _problem(run, run.done + before + 1, following, info)
        run.done += before
        _recorded(writer, steps[:before])
        return
    if int(info.inverted) and "inverted" not in run.warned:
        bar.clear()
        warning(_inversion(run, int(info.inverted), count, following))
        run.warned.add("inverted")
    if info.beyond_cone is not None and int(info.beyond_cone) and "cone" not in run.warned:
        bar.clear()
        warning(f"between steps {run.done} and {run.done + count}, {beyond(run.model, info)} (said once)")
        run.warned.add("cone")
    run.state, run.done = following, run.done + count
    _recorded(writer, steps)
    if run.done in (run.framed + run.every, run.steps):
        run.framed = run.done
        _written(run, writer, recorded=True)


def _recorded(writer: FrameWriter, steps: list[Seen]) -> None:
    """A row of the tables for each step."""
    for each in steps:
        energies = {kind: float(value) for kind, value in each.energies.items()}
        writer.record(float(each.time), energies, np.asarray(each.places))


def _written(run: Run, writer: FrameWriter, recorded: bool = False) -> None:
    """A frame of the state, and the state itself, from which a run can go on."""
    writer.write(run.state, recorded)
    if writer.listed:  # a checkpoint never knows of frames that the index does not list
        _checked(run, writer)


def _checked(run: Run, writer: FrameWriter) -> None:
    save_checkpoint(checkpoint_path(writer.index), run.state, run.done, run.dt, len(writer.saved), run.mark)


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
