"""What a batch does where the default is dear: a branch stays a branch, and solves that end at their own time do so."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

Array = jax.Array
F = TypeVar("F", bound=Callable[..., Any])


def lanes_in_turn(function: F) -> F:
    """`function` of arrays and pytrees, whose lanes under `vmap` are taken one after another on CPUs.

    For functions with long loops: a batched loop runs until its slowest lane ends, a batch of small dense products is
    no faster than one after another, and each lane's arrays stay in the cache. Accelerators batch. Where the first
    argument is the same for all lanes (many right-hand sides of one system) it is batched everywhere.
    Not for what derivatives go through in reverse.
    """
    turns = custom_vmap(function)

    @turns.def_vmap
    def rule(size: int, batched: list, first: Any, *others: Any) -> tuple[Any, Any]:
        axes = jax.tree.map(lambda flag: 0 if flag else None, tuple(batched))
        together = jax.vmap(function, axes, axis_size=size)
        if not any(jax.tree.leaves(batched[0])):
            made = lanes_in_turn(together)(first, *others)
        else:
            made = jax.lax.platform_dependent(
                first, *others, cpu=functools.partial(_one_by_one, function, batched), default=together
            )
        return made, jax.tree.map(lambda _: True, made)

    return functools.wraps(function)(lambda *arguments: turns(*arguments))  # type: ignore[return-value]


def _one_by_one(function: Callable[..., Any], batched: Any, *arguments: Any) -> Any:
    leaves, tree = jax.tree.flatten(arguments)
    flags = jax.tree.leaves(tuple(batched))

    def one(lane: list[Array]) -> Any:
        own = iter(lane)
        return lanes_in_turn(function)(
            *jax.tree.unflatten(tree, [next(own) if flag else leaf for leaf, flag in zip(leaves, flags, strict=True)])
        )

    return jax.lax.map(one, [leaf for leaf, flag in zip(leaves, flags, strict=True) if flag])


def cond_any(flag: Array, yes: Callable[..., Any], no: Callable[..., Any], *arguments: Any) -> Any:
    """`lax.cond(flag, yes, no, *arguments)` that stays a branch under `vmap`: `yes` for all lanes if any lane asks.

    So `yes` must also be right where `no` would do. vmap alone turns a branch into a selection, and always does both.
    Not for what derivatives go through in reverse.
    """

    @custom_vmap
    def branch(flag: Array, *given: Any) -> Any:
        return jax.lax.cond(flag, yes, no, *given)

    @branch.def_vmap
    def rule(size: int, batched: list, flag: Array, *given: Any) -> tuple[Any, Any]:
        axes = jax.tree.map(lambda each: 0 if each else None, tuple(batched[1:]))
        lanes = [jax.vmap(function, axes, axis_size=size) for function in (yes, no)]
        made = cond_any(jnp.any(flag), *lanes, *given)
        return made, jax.tree.map(lambda _: True, made)

    return branch(flag, *arguments)
