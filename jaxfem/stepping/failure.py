"""What a rollout does with a step that fails: it stops there, or takes it again in halved steps."""

import functools
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from jaxfem.batching import cond_any
from jaxfem.model import State, StepInfo
from jaxfem.pytrees import Pytree
from jaxfem.solvers.status import Status

Array = jax.Array
Advance = Callable[..., tuple[State, StepInfo]]

OnFailure = Literal["continue", "stop", "halve"]


def is_sound(state: State, info: StepInfo) -> Array:
    """Whether a step converged to a state of finite numbers, ()."""
    told = (state.positions, state.velocities, state.time, state.rigid, state.internal)
    finite = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(told) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    return jnp.stack([info.status == 0, *finite]).all()


def forgetting(advance: Advance) -> Advance:
    """`advance` with the derivatives of a step that fails cut: its NaN would spoil those of all steps before it.

    In reverse a zero times a NaN is a NaN, so the tangents are zeroed on both sides of the step. Only what has a
    tangent is differentiated in: other derivatives may be infinite in single precision, as those in the volumes of a
    body of 0.1 mm.
    """

    @jax.custom_jvp
    def attempt(*arguments: Any) -> Any:
        return advance(*arguments)

    def rule(primals: Any, tangents: Any) -> Any:
        leaves, tree = jax.tree.flatten(primals)
        every = enumerate(jax.tree.leaves(tangents))
        moving = {number: step for number, step in every if not isinstance(step, SymbolicZero)}

        def of_moving(moving: dict[int, Array]) -> tuple[State, StepInfo]:
            return advance(*jax.tree.unflatten(tree, [moving.get(k, leaf) for k, leaf in enumerate(leaves)]))

        made, push = jax.linearize(of_moving, {number: leaves[number] for number in moving})
        good = is_sound(*made)
        return made, _kept(good, push(_kept(good, moving)))

    attempt.defjvp(rule, symbolic_zeros=True)

    return attempt


def _kept(good: Array, tangents: Any) -> Any:
    """Tangents where `good`, else zero; those of integers have no numbers."""
    float0 = jax.dtypes.float0
    return jax.tree.map(lambda t: t if t.dtype == float0 else jnp.where(good, t, jnp.zeros_like(t)), tangents)


class Progress(Pytree):
    """A step on its way: the state so far, its info, how many pieces are left to go, and how large a step to try.

    Pieces are 2^-halvings of the step; `level`: how often the step is halved; `taken`: how many were accepted.
    `failed`: the status of the step at which the run has ended, 0 while it goes on.
    """

    state: State
    info: StepInfo
    left: Array
    level: Array
    taken: Array
    failed: Array


def persistent(
    advance: Advance, halvings: int, info: StepInfo
) -> Callable[[State, Array], tuple[State, Array, StepInfo]]:
    """One step that is taken again in halves where it fails, up to `halvings` times; then the run has ended.

    `advance(state, share)` takes the share of a step; `info`: one of its infos, for its structure. The result is
    called with the state and the status at which the run has ended (0: it goes on), and returns both and the info.
    Lanes of a batch end on their own; what is tried again is tried as long as any lane asks.
    """
    pieces = 2**halvings

    def attempt(at: Progress) -> Progress:
        size = pieces >> at.level
        following, told = advance(at.state, size / pieces)
        good, active = is_sound(following, told), at.left > 0
        level = jnp.where(active & ~good, at.level + 1, at.level)
        ended = active & (level > halvings)
        accepted = active & good
        status = jnp.where(told.status == 0, int(Status.NOT_FINITE), told.status)
        return Progress(
            _where(accepted | ended, following, at.state),
            _joined(at.info, told, active, accepted | ended),
            jnp.where(ended, 0, jnp.where(accepted, at.left - size, at.left)),
            jnp.minimum(level, halvings),
            at.taken + accepted,
            jnp.where(ended, status, at.failed),
        )

    def one(state: State, failed: Array) -> tuple[State, Array, StepInfo]:
        left = jnp.where(failed == 0, pieces, 0)
        none = jnp.zeros_like(left)
        at = Progress(
            state, jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), info), left, none, none, failed
        )

        def again(at: Progress, _: None) -> tuple[Progress, None]:
            return cond_any(at.left > 0, attempt, lambda at: at, at), None

        # Every accepted piece is at least 1, and every failure but the last halves it.
        at, _ = jax.lax.scan(again, at, length=pieces + halvings)
        told = at.info.replace(status=at.failed.astype(at.info.status.dtype))
        return at.state, at.failed, told.replace(substeps=at.taken) if halvings else told

    return one


def _joined(before: StepInfo, told: StepInfo, active: Array, kept: Array) -> StepInfo:
    """Infos of two parts of a step: all iterations that were spent, the largest of what was kept."""
    largest: StepInfo = jax.tree.map(lambda a, b: jnp.where(kept, jnp.maximum(a, b), a), before, told)
    spent = before.iterations + jnp.where(active, told.iterations, 0)
    return largest.replace(iterations=spent, inverted=jnp.where(kept, told.inverted, before.inverted))


def _where(flag: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(functools.partial(jnp.where, flag), yes, no)
