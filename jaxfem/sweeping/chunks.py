"""jf.sweep: many variants of one scene, chunk by chunk, on all devices."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import jax
import numpy as np

from jaxfem.model import Model, Params, State
from jaxfem.stepping.checks import check_call, check_rollout
from jaxfem.stepping.entering import typed
from jaxfem.sweeping.derivatives import flagged, floating
from jaxfem.sweeping.engines import ENGINES, Engine, Task
from jaxfem.sweeping.errors import SweepError
from jaxfem.sweeping.order import sorted_by
from jaxfem.sweeping.outputs import measuring
from jaxfem.sweeping.places import STEP, check_counts, check_places, place_of, stacked
from jaxfem.sweeping.result import SweepResult, columns
from jaxfem.sweeping.samples import Variants, checked

Array = jax.Array
AUTO = "auto"
ROOM = 1e9  # bytes that a chunk's saved states and outputs may take
Progress = Callable[[int, int, float], None]


class Sweep:
    """A sweep that is ready to run: chunks of one fixed width, each computed by the same program.

    Made as `sweep` is called, without running. `run(number)` gives what chunk `number` of `chunks` keeps, of the
    variants `members(number)`: the same bits each time that it is run with the same width, program and processor. The
    first one compiles, which takes `compiling` seconds.
    `order` (V,): in which variants go through chunks, where another sweep has found it already.
    """

    def __init__(
        self,
        model: Model,
        params: Params,
        state: State,
        variants: Mapping[str, Any],
        *,
        dt: float,
        steps: int,
        outputs: Mapping[str, Any],
        every: int = 1,
        change: Callable[..., tuple[Params, State]] | None = None,
        engine: str = AUTO,
        width: int | None = None,
        halvings: int = 0,
        derivatives: Sequence[str] = (),
        devices: Sequence[Any] | None = None,
        order: np.ndarray | None = None,
    ):
        params, state = typed(model, params, state)
        self.variants: Variants = checked(variants)
        first = {name: each[0] for name, each in self.variants.items()}
        check_call(model, params, state, dt)
        check_rollout(steps, every, None)
        places = [place_of(name, model, params, state, value) for name, value in first.items() if _takes(name, change)]
        check_places(places)
        check_counts(places, state, self.variants, model.rest.dtype)
        asked = _asked(derivatives, self.variants)
        measure = measuring(model, outputs)
        self.task = Task(model, params, state, dt, steps, every, tuple(places), measure, change, halvings, asked)
        self.dtype = model.rest.dtype
        self.devices = _devices(devices)
        self.engine, self.reason = chosen(self.task, engine, self.devices)
        self.count = len(next(iter(self.variants.values())))
        self._kept, self._states = self._bytes()
        self.width = self._width(width)
        self._order = order
        self._prepared = self.engine.prepare(self.task)
        self._compiled: Any = None  # with the first chunk
        self.compiling = 0.0

    @property
    def chunks(self) -> int:
        """How many chunks there are."""
        return -(-self.count // (self.width * len(self.devices)))

    @cached_property
    def order(self) -> np.ndarray | None:
        """In which variants go through chunks, (V,): those that wait for each other by what they cost; else None."""
        if self._order is not None or self.chunks == 1:
            return self._order
        costs = self.engine.costs(self.task, self._prepared, self.variants)
        return None if costs is None else sorted_by(costs, self.width * len(self.devices), self._kept)

    def members(self, chunk: int) -> np.ndarray:
        """Numbers of the variants that a chunk holds, lane by lane."""
        rows = self.rows(chunk)
        return np.arange(rows.start, rows.stop) if self.order is None else self.order[rows.start : rows.stop]

    def rows(self, chunk: int) -> range:
        """Which places in the order a chunk holds."""
        size = self.width * len(self.devices)
        return range(chunk * size, min((chunk + 1) * size, self.count))

    def run(self, chunk: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Outputs (c, ...) of a chunk, and `status`, `iterations`, `residual`, `inverted` (c,).

        A chunk that is not full is filled with its last variant: lanes have the same bits only at the same width.
        """
        own, size = self.members(chunk), self.width * len(self.devices)
        index = own[np.minimum(np.arange(size), len(own) - 1)]
        values = {name: stacked(each[index], self.dtype) for name, each in self.variants.items()}
        given = (self.task.model, self.task.params, self.task.state), self._prepared, values
        if self._compiled is None:
            begun = time.perf_counter()
            self._compiled = self._program().lower(*given).compile()
            self.compiling = time.perf_counter() - begun
        made = self._compiled(*given)
        outputs, told = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(own)], jax.block_until_ready(made))
        return outputs, flagged(outputs, told, self.task.derivatives)

    def _program(self) -> Any:
        whole = self.engine.make(self.task)
        if len(self.devices) == 1:
            return jax.jit(whole)
        mesh = jax.sharding.Mesh(np.array(self.devices), ("lanes",))
        spread, same = jax.sharding.PartitionSpec("lanes"), jax.sharding.PartitionSpec()
        return jax.jit(
            jax.shard_map(whole, mesh=mesh, in_specs=(same, same, spread), out_specs=(spread, spread), check_vma=False)
        )

    def _width(self, asked: int | None) -> int:
        """Lanes a device and chunk: what was asked for, or the engine's, as far as there are variants and memory."""
        if asked is not None:
            if isinstance(asked, bool) or not isinstance(asked, int | np.integer) or asked < 1:
                raise SweepError(f"width is {asked!r}; give how many variants a chunk, a whole number of at least 1")
            return int(asked)
        most = min(self.engine.widest(self.task, self.devices[0].platform), -(-self.count // len(self.devices)))
        while most > 1 and most * self._kept + self.engine.states_at_once(most) * self._states > ROOM:
            most //= 2
        return most

    def _bytes(self) -> tuple[int, int]:
        """Bytes of a variant's outputs, and of its saved states; errors of outputs show here, before compiling."""
        parts = (self.task.model, self.task.params, self.task.state)
        values = {name: jax.ShapeDtypeStruct(each.shape[1:], self.dtype) for name, each in self.variants.items()}
        kept = jax.eval_shape(dataclasses.replace(self.task, derivatives=()).one, parts, values)
        if self.task.derivatives:
            if not floating(kept[0]):
                raise SweepError("derivatives were asked for, and no output is a floating-point number")
            kept = jax.eval_shape(self.task.one, parts, values)
        _named(self.variants, *kept)
        # Backwards every step's state and solution are kept.
        frames = 3 * self.task.steps if self.task.derivatives else self.task.steps // self.task.every
        saved = sum(leaf.nbytes for leaf in jax.tree.leaves(self.task.state)) * frames
        return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(kept)), saved


def _named(variants: Variants, outputs: Mapping[str, Any], told: Mapping[str, Any]) -> None:
    """SweepError where two columns of a table would have one name."""
    blank = [{name: np.broadcast_to(0, (1, *each.shape)) for name, each in group.items()} for group in (told, outputs)]
    columns({"variant": np.zeros(1), "problem": np.zeros(1)}, {n: each[:1] for n, each in variants.items()}, *blank)


def _takes(name: str, change: Any) -> bool:
    """Whether a variable has a place of its own; those of a user's `change` are his, but for the known ones."""
    return change is None or name == STEP


def _devices(given: Sequence[Any] | None) -> tuple[Any, ...]:
    """All of the process's where None is given."""
    if given is None:
        return tuple(jax.local_devices())
    if not isinstance(given, Sequence) or not given or not all(isinstance(each, jax.Device) for each in given):
        raise SweepError(f"devices are {given!r}; give some of jax.local_devices(), in a list")
    return tuple(given)


def _asked(names: Sequence[str], variants: Variants) -> tuple[str, ...]:
    if isinstance(names, str) or not all(name in variants for name in names):
        raise SweepError(f"derivatives is {names!r}; give names of variables of this sweep: {', '.join(variants)}")
    return tuple(dict.fromkeys(names))


def chosen(task: Task, asked: str, devices: Sequence[Any]) -> tuple[Engine, str]:
    """The engine, and why. SweepError for one that is unknown, or asked for and cannot serve."""
    if asked != AUTO:
        if asked not in ENGINES:
            raise SweepError(f"engine is {asked!r}; known are {', '.join((AUTO, *ENGINES.words()))}")
        engine = ENGINES[asked].made()
        refused = engine.refuses(task)
        if refused:
            raise SweepError(f'engine "{asked}" {refused}: give engine = "auto"')
        return engine, "asked for"
    other, how = ("loop", "one after another") if devices[0].platform == "cpu" else ("vmap", "side by side")
    if "lanes" not in ENGINES:
        return ENGINES[other].made(), f"{how} is the fastest there"
    lanes = ENGINES["lanes"].made()
    refused = lanes.refuses(task) or lanes.slower(task)
    if refused:
        return ENGINES[other].made(), f'{how}, since engine "lanes" {refused}'
    return lanes, "soft bodies"


def sweep(
    model: Model,
    params: Params,
    state: State,
    variants: Mapping[str, Any],
    *,
    dt: float,
    steps: int,
    outputs: Mapping[str, Any],
    every: int = 1,
    change: Callable[..., tuple[Params, State]] | None = None,
    engine: str = AUTO,
    width: int | None = None,
    halvings: int = 0,
    derivatives: Sequence[str] = (),
    devices: Sequence[Any] | None = None,
    progress: Progress | None = None,
) -> SweepResult:
    """Run `steps` steps of `dt` [s] for each variant, and keep its `outputs`.

    `variants`: name -> values (V, ...), from `jaxfem.sweeping`'s grid, random, latin_hypercube, table, or your own. A
    name is how Python reaches the number in `params`: "young", 'young["beam"]' of one body, "gravity[2]", "loads[0]",
    'joints["..."].compliance'; "state.velocities" and its like for the start; "dt". With `change` (params, state,
    values) -> (params, state) names are yours. `outputs`: name -> a function of the run (`sweeping.Observed`, with
    states saved `every` so many steps), or "energies", "contact_forces", "frequencies", "positions", "rigid", or
    `sweeping.outputs.PointPath(place)`. `engine`: "auto", or one of `sweeping.engines.ENGINES`. `width`: variants a
    chunk and device; chunks are all of one width. A step that fails is taken in halves `halvings` times, then that
    variant stops, and its status says why; no other feels it. `derivatives`: names of variables in which the outputs
    are differentiated too, (V, *output, *variable) each: `result.derivative("tip", "young")`. `devices`: all of the
    process's where None.
    `progress(done, all, seconds left)` is called after each chunk. SweepError names what cannot be.
    """
    options = {"every": every, "change": change, "engine": engine, "width": width, "halvings": halvings}
    made = Sweep(
        model,
        params,
        state,
        variants,
        dt=dt,
        steps=steps,
        outputs=outputs,
        derivatives=derivatives,
        devices=devices,
        **options,  # type: ignore[arg-type]
    )
    return gathered(made, progress)


def gathered(made: Sweep, progress: Progress | None = None) -> SweepResult:
    """Run all chunks of a sweep."""
    parts, begun, compiled = [], time.perf_counter(), made.compiling
    for chunk in range(made.chunks):
        parts.append(made.run(chunk))
        if progress is not None:
            each = (time.perf_counter() - begun - (made.compiling - compiled)) / (chunk + 1)
            progress(made.rows(chunk).stop, made.count, each * (made.chunks - chunk - 1))
    back: Any = slice(None) if made.order is None else np.argsort(made.order)
    together: Any = jax.tree.map(lambda *leaves: np.concatenate(leaves)[back], *parts)
    outputs, told = together
    return SweepResult(
        made.variants,
        outputs,
        engine=made.engine.name,
        reason=made.reason,
        seconds=time.perf_counter() - begun,
        compiling=made.compiling - compiled,
        **told,
    )
