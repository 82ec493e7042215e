"""The impulses of all rows by elimination: an active set, and on the rows in play a factorised matrix.

The rows found at a bound are held there, the others solved for exactly; then rows outside their bounds are put on them,
and those that are held against their will let go (primal-dual active set: Hintermueller, Ito & Kunisch 2002). That ends
after a few rounds, but not for certain. So MPRGP has the last word: it starts from what was found, takes no step where
that is the answer, and finds the answer where it is not.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import pytree
from jaxfem.routes.row_factor import row_preconditioner
from jaxfem.routes.system import System
from jaxfem.solvers import trees
from jaxfem.solvers.mprgp import mprgp_loop
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo

Array = jax.Array
Impulses = tuple[Array, ...]

ROUNDS = 20
REFINEMENTS = 30
SHARE = 0.1  # of the tolerance, for each part of the work before the last word
ROUNDING = 4.0  # times the precision and the size of the terms of A lam: a residual with nothing but rounding left


@pytree
class _Round:
    impulses: Impulses
    sides: Impulses
    changed: Array
    rounds: Array
    products: Array


def search_by_elimination(
    system: System, guess: Impulses, operator: Any, right: Impulses, diagonal: Impulses, bounds: tuple
) -> tuple[Impulses, SolveInfo]:
    """Impulses within `bounds`, and info; its iterations are products with A."""
    root = jax.tree.map(jnp.sqrt, diagonal)
    wanted = system.tolerance * trees.norm(jax.tree.map(jnp.divide, right, root))
    bounded = any(low is not None for low in bounds[0])

    def solved(sides: Impulses) -> tuple[Impulses, Array]:
        return _solve_free(system, operator, right, diagonal, sides, held_at(sides, bounds), SHARE * wanted)

    if not bounded:
        found, products = solved(trees.zeros(guess))
    else:
        slack = jax.tree.map(lambda r: SHARE * wanted / (r * trees.size(guess) ** 0.5), root)

        def trip(last: _Round) -> _Round:
            found, products = solved(last.sides)
            gradient = trees.minus(operator(found), right)
            sides = _judged(found, gradient, diagonal, last.sides, slack, bounds)
            pairs = zip(jax.tree.leaves(sides), jax.tree.leaves(last.sides), strict=True)
            changed = jnp.stack([jnp.any(a != b) for a, b in pairs]).any()
            return _Round(found, sides, changed, last.rounds + 1, last.products + products + 1)

        zero = jnp.int32(0)
        first = _Round(guess, sides_of(guess, bounds, root), jnp.bool_(True), zero, zero)
        end = jax.lax.while_loop(lambda s: s.changed & (s.rounds < ROUNDS), trip, first)
        found, products = end.impulses, end.products
    floor = ROUNDING * jnp.finfo(root[0].dtype).eps * trees.norm(trees.times(root, found))
    size = trees.norm(jax.tree.map(jnp.divide, right, root))
    found, info = mprgp_loop(
        operator,
        right,
        *bounds,
        x0=found,
        diagonal=diagonal,
        tol=jnp.maximum(wanted, floor) / jnp.where(size > 0, size, 1),
        max_iterations=system.max_iterations,
    )
    return found, info.replace(iterations=info.iterations + products)  # type: ignore[attr-defined]


def sides_of(found: Impulses, bounds: tuple, like: Impulses) -> Impulses:
    """The side of its bounds that each impulse is at or beyond: -1, 1; 0 between, and without bounds."""

    def side(lam: Array, low: Any, up: Any) -> Array:
        return jnp.zeros_like(lam) if low is None else _side(lam, low, up, 0.0)

    return tuple(side(*each) for each in zip(found, *bounds, strict=True))


def held_at(sides: Impulses, bounds: tuple) -> Impulses:
    """Impulses of the rows at a bound; zero for all others."""

    def value(side: Array, low: Any, up: Any) -> Array:
        if low is None:
            return jnp.zeros_like(side)
        return jnp.where(side < 0, low, jnp.where(side > 0, up, 0))

    return tuple(value(*each) for each in zip(sides, *bounds, strict=True))


def _side(lam: Array, low: Array, up: Array, slack: Any) -> Array:
    outside = jnp.where(lam <= low - slack, -1, jnp.where(lam >= up + slack, 1, 0))
    return jnp.where(low >= up, -1, outside).astype(lam.dtype)


def _judged(found, gradient, diagonal, sides, slack, bounds) -> Impulses:
    """Sides for the next round: where a step down the gradient of the rows held, or the impulse found, leads outside."""

    def one(lam, g, d, side, s, low, up):
        if low is None:
            return side
        # A held row stays unless its gradient points inwards by more than the slack.
        return jnp.where(side == 0, _side(lam, low, up, s), _side(lam - g / d, low, up, -s))

    return tuple(one(*each) for each in zip(found, gradient, diagonal, sides, slack, *bounds, strict=True))


def _solve_free(
    system: System, operator: Any, right: Impulses, diagonal: Impulses, sides: Impulses, held: Impulses, target: Array
) -> tuple[Impulses, Array]:
    """Impulses with those at a bound held there and A lam = b on the others, to the target; and how many products."""
    free = jax.tree.map(lambda side: (side == 0).astype(side.dtype), sides)
    scale = jax.tree.map(lambda d, f: f * d**-0.5, diagonal, free)
    still = jax.tree.map(lambda f: 1 - f, free)

    def scaled(y: Impulses) -> Impulses:
        return trees.plus(trees.times(scale, operator(trees.times(scale, y))), 1.0, trees.times(still, y))

    rest = trees.times(scale, trees.minus(right, operator(held)))
    y, info = pcg(
        scaled,
        rest,
        row_preconditioner(system, diagonal, free),
        tol=0.0,
        absolute=target,
        max_iterations=jnp.minimum(system.max_iterations, REFINEMENTS),
    )
    return trees.plus(held, 1.0, trees.times(scale, y)), info.iterations
