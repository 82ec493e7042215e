"""What programs and batches do where the default is dear: small functions are one program outside of others, a branch
stays a branch in a batch, and solves that end at their own time do so."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir

Array = jax.Array
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


def one_program(function: F) -> F:
    """`function` of arrays and pytrees, as one program where it is called outside of others, not one an operation.

    Inside of others nothing changes.
    """
    made: Any = jax.jit(function, inline=True)
    return made  # type: ignore[no-any-return]


def one_trace(function: F) -> F:
    """`function` of arrays and pytrees, traced once for all programs that hold it, as a call.

    That is once for arguments of equal structure, shapes and types, static fields included, while the function itself
    lives: one made inside of another is shared by the uses there. What it does in Python beside it does once.
    """
    made: Any = jax.jit(function)
    return made  # type: ignore[no-any-return]


def lanes_in_turn(function: F) -> F:
    """`function` of arrays and pytrees, whose lanes under `vmap` are taken one after another on CPUs.

    For functions with long loops: a batched loop runs until its slowest lane ends, a batch of small dense products is
    no faster than one after another, and each lane's arrays stay in the cache. Accelerators batch. Where the first
    argument is the same for all lanes (many right-hand sides of one system) it is batched everywhere.
    Not for what derivatives go through in reverse.
    """
    turns = custom_vmap(one_trace(function))  # which JAX traces at each use, and once more where it is lowered

    @turns.def_vmap
    def rule(size: int, batched: list[Any], first: Any, *others: Any) -> tuple[Any, Any]:
        axes = jax.tree.map(lambda flag: 0 if flag else None, tuple(batched))
        together = jax.vmap(function, axes, axis_size=size)
        if not any(jax.tree.leaves(batched[0])):
            made = lanes_in_turn(together)(first, *others)
        else:
            made = jax.lax.platform_dependent(
                first, *others, cpu=functools.partial(_one_by_one, function, batched), default=together
            )
        return made, jax.tree.map(lambda _: True, made)

    wrapped: Any = functools.wraps(function)(lambda *arguments: turns(*arguments))
    typed: F = wrapped
    return typed


def _one_by_one(function: Callable[..., Any], batched: Any, *arguments: Any) -> Any:
    leaves, tree = jax.tree.flatten(arguments)
    flags = jax.tree.leaves(tuple(batched))

    def one(lane: list[Array]) -> Any:
        own = iter(lane)
        return lanes_in_turn(function)(
            *jax.tree.unflatten(tree, [next(own) if flag else leaf for leaf, flag in zip(leaves, flags, strict=True)])
        )

    return jax.lax.map(one, [leaf for leaf, flag in zip(leaves, flags, strict=True) if flag])


def cond_any(flag: Array, yes: Callable[..., T], no: Callable[..., T], *arguments: Any) -> T:
    """`lax.cond(flag, yes, no, *arguments)` that stays a branch under `vmap`: `yes` for all lanes if any lane asks.

    So `yes` must also be right where `no` would do. vmap alone turns a branch into a selection, and always does both.
    Differentiable as the branch itself is.
    """
    found: T = jax.lax.cond(any_lane(flag), yes, no, *arguments)
    return found


def any_lane(flag: Array) -> Array:
    """The flag itself; under `vmap`, one for all lanes: whether any of them has it."""
    asked: Array = _any_lane.bind(flag)
    return asked


# vmap's rules for JAX's own operations keep lanes apart, and custom_vmap has no reverse derivative.
_any_lane = Primitive("any_lane")
_any_lane.def_impl(lambda flag: flag)
_any_lane.def_abstract_eval(lambda flag: flag)
mlir.register_lowering(_any_lane, lambda _, flag: [flag])
batching.primitive_batchers[_any_lane] = lambda flags, axes: (any_lane(jnp.any(flags[0], axis=axes[0])), None)
