"""A solve that JAX runs as it is, and differentiates by the condition that its solution meets."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from jaxfem.batching import one_trace

Array = jax.Array
F = TypeVar("F", bound=Callable[..., Any])
Solve = Callable[..., tuple[Any, Any]]
Pushed = Callable[[Callable[..., Any]], Any]
Tangent = Callable[[Any, Any, Any, Pushed], Any]

SOLUTION = "jaxfem_solution"
"""Name under which solutions are marked, so that checkpointing can keep them and recompute everything else."""


def recomputed(function: F) -> F:
    """`function`, of whose run reverse derivatives keep the solutions of `solved` alone, and compute the rest again.

    Solutions are small and dear, all else is large and cheap. Kept, it would also pass through every scan and branch
    around: a rollout's gradient has a third of the kernels so, and takes no longer. Forwards it is `function` itself.
    """
    keep = jax.checkpoint_policies.save_only_these_names(SOLUTION)
    again: Any = jax.checkpoint(function, policy=keep, prevent_cse=False)
    same: F = again
    return same


def solved(solve: Solve, tangent: Tangent, *arguments: Any) -> tuple[Any, Any]:
    """`solve(*arguments)`, (unknown, rest): a program that is not differentiated holds that alone.

    `tangent(unknown, rest, arguments, pushed)` is the change of the unknown, linear in `pushed`: pushed(f) is how
    f(*arguments) changes with them, `unknown` and `rest` held. `rest` has no derivative. `solve` is never
    differentiated; neither function may hold traced values of its own. Every mode works, nested and in scans.
    """
    leaves, tree = jax.tree.flatten(arguments)
    program = _Program(solve, tangent, tree)
    made, (unknown, rest) = jax.make_jaxpr(program.run, return_shape=True)(*leaves)
    program = dataclasses.replace(program, unknown=jax.tree.structure(unknown), rest=jax.tree.structure(rest))
    return program.parted(_solved.bind(*leaves, program=program, made=made))


@dataclasses.dataclass(frozen=True)
class _Program:
    """The two functions, on flat lists of leaves; with the structure of what goes in and comes out."""

    solve: Solve
    tangent: Tangent
    tree: Any
    unknown: Any = None
    rest: Any = None

    def run(self, *leaves: Array) -> tuple[Any, Any]:
        # Else all of it would be traced once more where it is lowered.
        found: tuple[Any, Any] = one_trace(self.solve)(*jax.tree.unflatten(self.tree, leaves))
        return found

    def parted(self, found: Sequence[Array]) -> tuple[Any, Any]:
        count = self.unknown.num_leaves
        return jax.tree.unflatten(self.unknown, found[:count]), jax.tree.unflatten(self.rest, found[count:])

    def change(self, found: list[Array], leaves: list[Array], steps: dict[int, Array]) -> list[Array]:
        """Tangents of the unknown's leaves; `steps`: those of the arguments' leaves that have one."""

        def pushed(function: Callable[..., Any]) -> Any:
            def of_moving(moving: dict[int, Array]) -> Any:
                own = [moving.get(number, leaf) for number, leaf in enumerate(leaves)]
                return function(*jax.tree.unflatten(self.tree, own))

            return jax.jvp(of_moving, ({number: leaves[number] for number in steps},), (steps,))[1]

        unknown, rest = self.parted(found)
        return jax.tree.leaves(self.tangent(unknown, rest, jax.tree.unflatten(self.tree, leaves), pushed))


@dataclasses.dataclass(frozen=True)
class _Lanes:
    """The same for a batch; `axes`: along which axis each leaf is one, None where it is the same for all lanes."""

    one: Any
    axes: tuple[int | None, ...]
    size: int

    @property
    def unknown(self) -> Any:
        return self.one.unknown

    def change(self, found: list[Array], leaves: list[Array], steps: dict[int, Array]) -> list[Array]:
        own = {number: self.axes[number] for number in steps}
        batch = jax.vmap(self.one.change, (0, list(self.axes), own), axis_size=self.size)
        change: list[Array] = batch(found, leaves, steps)
        return change


# A primitive and not `jax.custom_jvp`: taking a scan apart for reverse derivatives drops the rules of the latter, and
# what is differentiated next then goes through the solver's loop.
_solved = Primitive("jaxfem_solved")
_solved.multiple_results = True


def _run(*leaves: Array, program: Any, made: ClosedJaxpr) -> list[Array]:
    found: list[Array] = jaxpr_as_fun(made)(*leaves)
    return found


def _jvp(primals: Sequence[Array], tangents: Sequence[Any], *, program: Any, made: ClosedJaxpr) -> tuple[Any, Any]:
    found = [checkpoint_name(leaf, SOLUTION) for leaf in _solved.bind(*primals, program=program, made=made)]
    moving = {number: step for number, step in enumerate(tangents) if not _still(step)}
    none = [ad.Zero(jax.typeof(leaf).to_tangent_aval()) for leaf in found]
    change = program.change(found, list(primals), moving)
    return found, change + none[len(change) :]


def _still(tangent: Any) -> bool:
    return isinstance(tangent, ad.Zero) or getattr(tangent, "dtype", None) == jax.dtypes.float0


def _batched(leaves: Sequence[Array], axes: Sequence[Any], *, program: Any, made: ClosedJaxpr) -> tuple[Any, Any]:
    lanes = tuple(axes)
    size = next(np.shape(leaf)[axis] for leaf, axis in zip(leaves, lanes, strict=True) if axis is not None)
    together = jax.vmap(jaxpr_as_fun(made), lanes, axis_size=size)
    found = _solved.bind(*leaves, program=_Lanes(program, lanes, size), made=jax.make_jaxpr(together)(*leaves))
    return found, [0] * len(found)


_solved.def_impl(jax.jit(_run, static_argnames=("program", "made")))
_solved.def_abstract_eval(lambda *leaves, program, made: made.out_avals)
mlir.register_lowering(_solved, mlir.lower_fun(_run, multiple_results=True))
ad.primitive_jvps[_solved] = _jvp
batching.primitive_batchers[_solved] = _batched
