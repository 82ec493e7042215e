"""Soft bodies on CPUs with lanes last: see `jaxfem.sweeping.lanes`."""

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxfem.elements.mass import is_diagonal
from jaxfem.materials.linear import Linear
from jaxfem.methods.nodes.method import Condensed
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.stepping.values import value_status
from jaxfem.sweeping.engines.base import Engine, Kept, Task, told
from jaxfem.sweeping.lanes.body import Body, body_of
from jaxfem.sweeping.lanes.steps import Moving, Told, first, inside_out, lane_of, step
from jaxfem.sweeping.outputs import Observed

Array = jax.Array
LARGEST = 3000  # free directions, beyond which all modes are too dear to find and to use


class LanesLast(Engine):
    """Chunks of lanes that go through each step together."""

    name: ClassVar[str] = "lanes"
    width: ClassVar[int] = 32

    def states_at_once(self, width: int) -> int:
        """All of a chunk."""
        return width

    def refuses(self, task: Task) -> str | None:
        """What is not written with lanes last."""
        model, state = task.model, task.state
        plain = len(model.domains) == 1 and model.domains[0].part == "full" and model.domains[0].members is None
        reasons = {
            "takes soft bodies alone, and this scene has rigid bodies, joints or contacts": model.coupled,
            "takes the linear law, and this scene has another": any(type(law) is not Linear for law in model.laws),
            "takes strain of elements, and this scene smooths it": not plain,
            "takes lumped masses": not is_diagonal(model.mass),
            "takes the nearest rotation": model.rotation != "polar",
            "takes the method condensed with explicit rotations": type(model.method) is not Condensed,
            "keeps no momentum of bodies that nothing holds": model.drifting is not None,
            "keeps no account of energy": state.account is not None,
            "takes no failed step again": task.halvings > 0,
            "takes scenes of build, not of rebuild": model.reshaped,
            f"takes at most {LARGEST} free directions": 3 * int(model.free.sum()) > LARGEST,
        }
        return next((words for words, so in reasons.items() if so), None)

    def prepare(self, task: Task) -> Body:
        """Connectivity and modes."""
        return body_of(task.model, task.params)

    def make(self, task: Task) -> Callable[[Any, Any, Any], Kept]:
        """Of the whole chunk."""

        def run(parts: tuple[Model, Params, State], body: Body, values: dict[str, Array]) -> Kept:
            return _run(task, parts, body, values)

        return run


def _run(task: Task, parts: tuple[Model, Params, State], body: Body, values: dict[str, Array]) -> Kept:
    model = parts[0]

    def start(own: dict[str, Array]) -> Any:
        params, state, dt = task.variant(parts, own)
        dt = jnp.asarray(dt, model.rest.dtype)
        status = value_status(model, params, state, dt, None)
        return params, state, dt, lane_of(model, body, params), first(model, body, params, state, status)

    params, state, dt, lane, at = jax.vmap(start, out_axes=-1)(values)

    def one(_: Any, carry: Any) -> Any:
        at, worst = carry
        at, now = step(model, body, lane, params, at, dt)
        return at, Told(now.status, *(jnp.maximum(a, b) for a, b in zip(_largest(worst), _largest(now), strict=True)))

    def frame(at: Moving, _: None) -> tuple[Moving, tuple[Moving, Told]]:
        zeros = jnp.zeros(at.failed.shape, jnp.int32)
        blank = Told(at.failed, zeros, jnp.zeros(at.failed.shape, model.rest.dtype), zeros)
        at, found = jax.lax.fori_loop(0, task.every, one, (at, blank))
        ended = found.replace(inverted=jnp.maximum(found.inverted, inside_out(body, at.positions)))
        return at, (at, ended)

    _, (saved, infos) = jax.lax.scan(frame, at, None, length=task.steps // task.every)

    def kept(params: Params, state: State, dt: Array, saved: Moving, infos: Told) -> Kept:
        states = _states(body, state, saved)
        told_of = StepInfo(infos.status, infos.iterations, infos.residual, jnp.zeros_like(infos.status), infos.inverted)
        return task.measure(Observed(model, params, state, states, told_of, dt)), told(told_of)

    return jax.vmap(kept, in_axes=-1)(params, state, dt, saved, infos)


def _largest(found: Told) -> tuple[Array, Array, Array]:
    return found.iterations, found.residual, found.inverted


def _states(body: Body, start: State, saved: Moving) -> State:
    """Saved states of one lane in the model's order of nodes, (k, ...)."""
    count = saved.time.shape[0]
    every = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), start)
    accelerations = None if saved.accelerations is None else saved.accelerations[:, body.back]
    found: State = every.replace(
        positions=saved.positions[:, body.back],
        velocities=saved.velocities[:, body.back],
        accelerations=accelerations,
        time=saved.time,
    )
    return found
