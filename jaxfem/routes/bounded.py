"""Condensed route with rows that stay rows: contacts, limits, motors, joints beside the nodes' big matrix.

Elastic rows are eliminated as ever; the others (any kind that is not elastic) keep their impulses as unknowns. So
the condition on the pair (v, lam) has no division by a compliance, however small, and its derivative is symmetric:

    M (v - v*) - J_e' lam_e(v) - J' lam = 0;   c - J v - C lam = 0 between the bounds, lam = bound at one.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import lanes_in_turn
from jaxfem.routes.assembly import BlockMatrix
from jaxfem.routes.condensed import condensed_matrix, group_modes
from jaxfem.routes.preconditioner import coarse_correction, inverse_blocks
from jaxfem.routes.row_stiffness import RowStiffness, local_compliance, smoother
from jaxfem.routes.system import System, elastic_part, extra_rows, merged, momentum_gradient
from jaxfem.rows.points import PointRows
from jaxfem.solvers.box import make_box
from jaxfem.solvers.semismooth import RowTerms, minimize_with_rows
from jaxfem.solvers.status import SolveInfo

Array = jax.Array
Pair = tuple[Array, tuple[Array, ...]]


def pair_gradient(system: System, unknown: Pair) -> Pair:
    """The condition above at velocities (n, 3) of the free nodes and impulses of the extra rows; zero at the solution.

    Which rows are at a bound is read off the impulses.
    """
    velocities, impulses = merged(system, unknown[0]), unknown[1]
    pushed = jnp.zeros_like(velocities)
    residuals = []
    for rows, lam in zip(extra_rows(system), impulses, strict=True):
        held, bound = _held(rows, lam)
        pushed = pushed + rows.apply_transpose(jnp.where(held, bound, lam))
        free = rows.bias - rows.apply(velocities) - rows.compliance * lam
        residuals.append(jnp.where(held, lam - bound, free))
    momentum = momentum_gradient(elastic_part(system), unknown[0])
    return momentum - jnp.where(system.free[:, None] > 0, pushed, 0), tuple(residuals)


def _held(rows: PointRows, impulses: Array) -> tuple[Array, Array]:
    """Which rows are at a bound, and that bound; between equal bounds, their mean."""
    if rows.bounds is None:
        return jnp.zeros(impulses.shape, bool), impulses
    low, up = rows.bounds
    at_low, at_up = impulses <= low, impulses >= up
    bound = jnp.where(at_low & at_up, 0.5 * (low + up), jnp.where(at_low, low, up))
    return at_low | at_up, jnp.where(at_low | at_up, bound, 0)


@lanes_in_turn
def solve_bounded(system: System, guess: Pair) -> tuple[Pair, SolveInfo]:
    """End-of-step velocities of the free nodes (n, 3) and impulses of the extra rows, from a guess; and info."""
    free = system.free[:, None]
    start = guess[0] * free
    velocities = merged(system, start)
    extra = extra_rows(system)
    terms = _terms(
        extra,
        slack=tuple(rows.bias - rows.apply(velocities) for rows in extra),
        start=guess[1],
        bounds=tuple((None, None) if rows.bounds is None else rows.bounds for rows in extra),
    )
    gradient = momentum_gradient(elastic_part(system), start)
    step, impulses, info = _minimize(system, gradient, terms, system.floor)
    end = start + step * free
    weak = weakly_active(system, merged(system, end), impulses)
    return (end, impulses), info.replace(weakly_active=weak)  # type: ignore[attr-defined]


@lanes_in_turn
def solve_pair_tangent(system: System, unknown: Pair, right: Pair) -> tuple[Pair, SolveInfo]:
    """Solve the derivative of `pair_gradient` at `unknown` for `right`, the rows at a bound held there."""
    extra = extra_rows(system)
    held = tuple(_held(rows, lam)[0] for rows, lam in zip(extra, unknown[1], strict=True))
    active = tuple(~mask for mask in held)
    terms = _terms(
        extra,
        slack=tuple(jnp.where(on, -r, 0) for on, r in zip(active, right[1], strict=True)),
        start=tuple(jnp.zeros_like(r) for r in right[1]),
        bounds=((None, None),) * len(extra),
        active=active,
    )
    velocities, impulses, info = _minimize(system, -right[0], terms, 0.0)
    return (velocities, tuple(map(jnp.where, held, right[1], impulses))), info


def weakly_active(system: System, velocities: Array, impulses: tuple[Array, ...]) -> Array:
    """Number of extra rows at a bound with no force against it, as MPRGP on all rows counts them."""
    inverse_mass = system.free / system.mass
    square, boxes = jnp.zeros((), velocities.dtype), []
    extra = extra_rows(system)
    for rows in system.rows:
        scale = rows.diagonal(inverse_mass) + rows.compliance
        square = square + jnp.sum((rows.bias - rows.apply(system.target)) ** 2 / scale)
    tolerance = jnp.maximum(system.tolerance, jnp.finfo(velocities.dtype).eps)
    threshold = 10 * tolerance * jnp.sqrt(square)
    for rows, lam in zip(extra, impulses, strict=True):
        root = jnp.sqrt(rows.diagonal(inverse_mass) + rows.compliance)
        gap = rows.apply(velocities) + rows.compliance * lam - rows.bias
        lower, upper = (None, None) if rows.bounds is None else rows.bounds
        boxes.append(make_box(lam, lower, upper).divided(1 / root).weak(lam * root, gap / root, threshold))
    return sum(boxes[1:], start=boxes[0])


def _terms(extra: Any, slack: Any, start: Any, bounds: Any, active: Any = None) -> RowTerms:
    compliance = tuple(jnp.broadcast_to(rows.compliance, rows.bias.shape) for rows in extra)
    lower, upper = zip(*bounds, strict=True)
    return RowTerms(slack, compliance, lower, upper, start, compliance, active or (None,) * len(extra))


def _minimize(
    system: System, gradient: Array, terms: RowTerms, absolute: Any
) -> tuple[Array, tuple[Array, ...], SolveInfo]:
    """The semismooth solve in solver order, from a gradient in the user's."""
    matrix, pattern = condensed_matrix(system), system.pattern
    rows = tuple(_placed(system, each) for each in extra_rows(system))
    diagonal = matrix.diagonal_blocks
    inverse = inverse_blocks(diagonal)
    local = tuple(local_compliance(each, inverse) for each in rows)
    step, impulses, info = minimize_with_rows(
        matrix.apply,
        pattern.gathered(gradient),
        rows,
        terms.replace(local=local),  # type: ignore[attr-defined]
        _preconditioner(system, matrix, rows),
        tol=system.tolerance,
        max_iterations=system.max_iterations,
        absolute=absolute,
    )
    return pattern.scattered(step), impulses, info


def _placed(system: System, rows: PointRows) -> PointRows:
    """The rows on unknowns in solver order, without their hold on fixed nodes."""
    pattern = system.pattern
    moving = jnp.repeat(system.free[rows.triples], 3, axis=1)[:, None]
    triples, count = pattern.place[rows.triples], pattern.order.shape[0]
    return rows.replace(triples=triples, jacobian=rows.jacobian * moving, unknowns=count)  # type: ignore[attr-defined]


def _preconditioner(system: System, matrix: BlockMatrix, rows: tuple[PointRows, ...]) -> Any:
    """stiffness -> preconditioner: P = (D + J' k J)^-1 on the nodes, and the coarse space seen through it.

    P + P D B D P, with D the diagonal blocks and B the coarse correction without rows. P D takes out of the coarse
    modes what stiff rows forbid, so B, built once for all active sets, does not fight them. Volumetric rows shared by
    clusters are not in it: bodies near nu = 0.5 with extra rows take more iterations.
    """
    coarse = coarse_correction(group_modes(system), system.coarse)
    diagonal = matrix.diagonal_blocks

    def weighted(field: Array) -> Array:
        return jnp.einsum("nij,nj->ni", diagonal, field)

    def build(stiffness: tuple[Array, ...]) -> Any:
        smooth = smoother(diagonal, tuple(map(RowStiffness, rows, stiffness)))

        def apply(residual: Array) -> Array:
            first = smooth(residual)
            return first + smooth(weighted(coarse(weighted(first))))

        return apply

    return build
