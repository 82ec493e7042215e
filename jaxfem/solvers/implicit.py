"""One derivative rule for every solver: differentiate the condition that the solution meets, not the iterations."""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jax.flatten_util import ravel_pytree

from jaxfem.batching import cond_any
from jaxfem.solvers.status import SolveInfo, Status

Array = jax.Array

SOLUTION = "jaxfem_solution"
"""Name under which solutions are marked, so that checkpointing can keep them and recompute everything else."""


class Condition(Protocol):
    """A condition gradient(inputs, unknown) = 0 and ways of solving it; hashable, holds no arrays."""

    @property
    def symmetric(self) -> bool:
        """Whether the gradient's derivative in the unknown is symmetric."""

    def gradient(self, inputs: Any, unknown: Array) -> Array:
        """The residual, zero at the solution; differentiable in both arguments."""

    def solve(self, inputs: Any, guess: Array) -> tuple[Array, Any]:
        """The solution and its info; may use any loop, is never differentiated."""

    def tangent_solve(self, inputs: Any, unknown: Array, right: Array, matvec: Callable[[Array], Array]) -> Array:
        """Solve (d gradient / d unknown) y = right at the solution; its own arithmetic is never differentiated.

        `matvec` is that Jacobian, or its transpose when a condition without symmetry is differentiated backwards.
        """


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit_solution(condition: Condition, inputs: Any, guess: Array) -> tuple[Array, Any]:
    """Solve the condition for the unknown; differentiable in `inputs` by the implicit function theorem.

    Returns (solution, info). `guess` only starts the solver and gets no derivative. Forward, reverse and nested
    derivatives work; each costs one linear solve of the same kind. Source: Christianson 1994; Griewank & Walther 2008.
    """
    return condition.solve(inputs, guess)


@implicit_solution.defjvp
def _implicit_jvp(condition: Condition, primals: tuple, tangents: tuple) -> tuple:
    inputs, guess = primals
    unknown, info = implicit_solution(condition, inputs, guess)
    unknown = checkpoint_name(unknown, SOLUTION)
    # gradient(inputs, unknown) = 0   =>   H d unknown = -(d gradient / d inputs) d inputs
    _, right = jax.jvp(lambda i: condition.gradient(i, unknown), (inputs,), (tangents[0],))
    return (unknown, info), (-_hessian_solve(condition, inputs, unknown, right), jax.tree.map(_zero_tangent, info))


def piecewise_linear_solution(condition: Condition, inputs: Any, guess: Any) -> tuple[Any, Any]:
    """The same as `implicit_solution` for a condition that is piecewise linear in the unknown, an array or a pytree.

    At the solution x* found, x = x* - H^-1 (g(inputs, x*) - [the same, held fixed]) has the value x* and, as g is
    linear in x around it, every derivative of the implicit function. The only primitive in it is a linear solve, so it
    can be nested in scans in any mode, reverse over reverse included, where JAX drops custom rules.
    """
    found, info = jax.lax.stop_gradient(condition.solve(*jax.lax.stop_gradient((inputs, guess))))
    found = jax.tree.map(lambda leaf: checkpoint_name(leaf, SOLUTION), found)
    residual = condition.gradient(inputs, found)
    change = jax.tree.map(lambda leaf: leaf - jax.lax.stop_gradient(leaf), residual)
    return jax.tree.map(jnp.subtract, found, _hessian_solve(condition, inputs, found, change)), info


def _hessian_solve(condition: Condition, inputs: Any, unknown: Any, right: Any) -> Any:
    """H^-1 right, with H the derivative of the gradient in the unknown; a primitive that JAX can differentiate."""

    # One flat vector: JAX cannot transpose a linear solve when only some leaves of its right-hand side have a tangent.
    vector, shaped = ravel_pytree(right)

    def hessian(direction: Array) -> Array:
        return ravel_pytree(jax.jvp(lambda u: condition.gradient(inputs, u), (unknown,), (shaped(direction),))[1])[0]

    def solve(matvec: Callable[[Array], Array], flat: Array) -> Array:
        def shaped_matvec(direction: Any) -> Any:
            return shaped(matvec(ravel_pytree(direction)[0]))

        held = jax.lax.stop_gradient((inputs, unknown))
        return ravel_pytree(condition.tangent_solve(*held, shaped(flat), shaped_matvec))[0]

    return shaped(
        jax.lax.custom_linear_solve(hessian, vector, solve, transpose_solve=solve, symmetric=condition.symmetric)
    )


def unless_zero(solve: Callable[[Any, Any], tuple[Any, SolveInfo]], inputs: Any, right: Any) -> tuple[Any, SolveInfo]:
    """`solve(inputs, right)`, (solution, info); zero without solving where `right` is zero.

    That is so whenever a solution is computed but not differentiated, and setting up a system may be half the work.
    """

    def nothing(inputs: Any, right: Any) -> tuple[Any, SolveInfo]:
        dtype = jnp.result_type(*jax.tree.leaves(right))
        none = jnp.int32(0)
        return jax.tree.map(jnp.zeros_like, right), SolveInfo(none, none, jnp.zeros((), dtype), none)

    some = jnp.stack([jnp.any(leaf != 0) for leaf in jax.tree.leaves(right)]).any()
    return cond_any(some, solve, nothing, inputs, right)  # type: ignore[no-any-return]


def or_nan(solution: Any, info: Any) -> Any:
    """A derivative whose linear solve failed is NaN, never a plausible number."""
    return jax.tree.map(lambda leaf: jnp.where(info.status == int(Status.CONVERGED), leaf, jnp.nan), solution)


def _zero_tangent(value: Array) -> Any:
    if jnp.issubdtype(jnp.result_type(value), jnp.inexact):
        return jnp.zeros_like(value)
    return np.zeros(jnp.shape(value), jax.dtypes.float0)
