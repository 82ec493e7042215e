"""One derivative rule for every solver: differentiate the condition that the solution meets, not the iterations."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxfem.batching import cond_any, one_trace
from jaxfem.solvers.differentiation import solved
from jaxfem.solvers.status import SolveInfo, Status

Array = jax.Array
T = TypeVar("T")

__all__ = ["Condition", "implicit_solution", "or_nan", "tangent_solution", "unless_zero"]


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


def implicit_solution(condition: Condition, inputs: Any, guess: Any) -> tuple[Any, Any]:
    """Solve the condition for the unknown, an array or a pytree; differentiable by the implicit function theorem.

    Returns (solution, info). `guess` only starts the solver and gets no derivative. Forward, reverse and nested
    derivatives in `inputs` work; each costs one linear solve of the same kind, a program without them none.
    Source: Christianson 1994; Griewank & Walther 2008.
    """

    def tangent(unknown: Any, info: Any, arguments: tuple[Any, Any], pushed: Any) -> Any:
        inputs, _ = arguments
        # gradient(inputs, unknown) = 0   =>   H d unknown = -(d gradient / d inputs) d inputs
        right = pushed(lambda inputs, guess: condition.gradient(inputs, unknown))
        held = jax.lax.stop_gradient((inputs, unknown))
        return tangent_solution(
            lambda u: condition.gradient(inputs, u),
            unknown,
            right,
            lambda matvec, vector: condition.tangent_solve(*held, vector, matvec),
            condition.symmetric,
        )

    return solved(condition.solve, tangent, inputs, jax.lax.stop_gradient(guess))


def tangent_solution(
    gradient: Callable[[Any], Any],
    unknown: Any,
    right: Any,
    solve: Callable[[Callable[[Any], Any], Any], Any],
    symmetric: bool,
) -> Any:
    """-H^-1 right, with H the derivative of `gradient` at the unknown; a primitive that JAX can differentiate.

    `solve(matvec, right)` finds H^-1 right, or H'^-1 right where it is given products with that.
    """
    # One flat vector: JAX cannot transpose a linear solve when only some leaves of its right-hand side have a tangent.
    vector, shaped = ravel_pytree(right)

    @one_trace  # the solver takes many products
    def hessian(direction: Array) -> Array:
        return ravel_pytree(jax.jvp(gradient, (unknown,), (shaped(direction),))[1])[0]

    def flat_solve(matvec: Callable[[Array], Array], flat: Array) -> Array:
        def shaped_matvec(direction: Any) -> Any:
            return shaped(matvec(ravel_pytree(direction)[0]))

        return ravel_pytree(solve(shaped_matvec, shaped(flat)))[0]

    found = jax.lax.custom_linear_solve(hessian, -vector, flat_solve, transpose_solve=flat_solve, symmetric=symmetric)
    return shaped(found)


def unless_zero(solve: Callable[[Any, T], tuple[T, SolveInfo]], inputs: Any, right: T) -> tuple[T, SolveInfo]:
    """`solve(inputs, right)`, (solution, info), of a linear solve; zero without solving where `right` is zero.

    That is so for steps that what is differentiated does not depend on, and setting up a system may be half the work.
    Derivatives come in units of their own: squares of what is small in them, as of forces per pascal, are lost in
    single precision. So `right` is brought to a size of about 1, by a power of two, which rounds nothing.
    """

    def nothing(inputs: Any, right: T) -> tuple[T, SolveInfo]:
        dtype = jnp.result_type(*jax.tree.leaves(right))
        none = jnp.int32(0)
        return jax.tree.map(jnp.zeros_like, right), SolveInfo(none, none, jnp.zeros((), dtype), none)

    def sized(inputs: Any, right: T) -> tuple[T, SolveInfo]:
        size = jnp.stack([jnp.abs(leaf).max() for leaf in jax.tree.leaves(right)]).max()
        size = jnp.where(jnp.isfinite(size) & (size > 0), size, 1)
        scale = jnp.ldexp(jnp.ones_like(size), -jnp.frexp(size)[1])
        found, info = solve(inputs, jax.tree.map(lambda leaf: leaf * scale, right))
        whole: T = jax.tree.map(lambda leaf: leaf / scale, found)
        return whole, info

    some = jnp.stack([jnp.any(leaf != 0) for leaf in jax.tree.leaves(right)]).any()
    return cond_any(some, sized, nothing, inputs, right)


def or_nan(solution: T, info: Any) -> T:
    """A derivative whose linear solve failed is NaN, never a plausible number."""
    found: T = jax.tree.map(lambda leaf: jnp.where(info.status == int(Status.CONVERGED), leaf, jnp.nan), solution)
    return found
