"""Condensed route with rows that stay rows: contacts, friction, limits, motors, joints beside the nodes' big matrix.

Elastic rows are eliminated as ever; the others (any kind that is not elastic) keep their impulses as unknowns. So
the condition on the pair (v, lam) has no division by a compliance, however small, and its derivative is symmetric:

    M (v - v*) - J_e' lam_e(v) - J' lam = 0;   c - J v - C lam = 0 between the bounds, lam = bound at one.

Rigid bodies are further triples with 3x3 blocks of their own. A friction bound moves with its normal impulse, which
makes the derivative unsymmetric: see `solve_pair_tangent`. A Schur complement on these rows would take one more solve a
row and step; this way a cube on the ground, up to 363 rows, takes 16 iterations in all (benchmarks/soft_cube.py).
"""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import lanes_in_turn, one_program
from jaxfem.indexing import gather
from jaxfem.methods.nodes.assembly import BlockMatrix
from jaxfem.methods.nodes.condensed import condensed_matrix, group_modes
from jaxfem.methods.nodes.cone import cone_residual, width
from jaxfem.methods.nodes.extra_terms import bounds_of, following, held_rows, tangent_terms, terms_at, without_room
from jaxfem.methods.nodes.preconditioner import coarse_correction, coarse_matrix
from jaxfem.methods.nodes.row_coarse import coarse_space
from jaxfem.methods.nodes.row_stiffness import RowStiffness, few, local_compliance, smoother, stiffened
from jaxfem.rows.bounds import Impulses, friction_radii, named, placed_at_bounds, sides_of, without_cones
from jaxfem.rows.points import PointRows
from jaxfem.solvers.bicgstab import bicgstab
from jaxfem.solvers.box import make_box
from jaxfem.solvers.implicit import or_nan, unless_zero
from jaxfem.solvers.row_terms import RowTerms
from jaxfem.solvers.semismooth import SHARPEST, minimize_with_rows
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.soft import System, inverse_mass, merged, momentum_gradient
from jaxfem.tensors import contract, inner, inverse_blocks

Array = jax.Array
Pair = tuple[Array, Impulses]

SHARPEST_TIED = 0.1
"""The last share of compliance (see `semismooth.py`) where rows between bodies are too many to be treated exactly."""


@one_program
def pair_gradient(system: System, unknown: Pair) -> Pair:
    """The condition above at velocities (n, 3) of the free triples and the extra rows' impulses; zero at the solution.

    Which rows are at a bound is read off the impulses.
    """
    pushed, residuals = row_gradient(system, merged(system, unknown[0]), unknown[1])
    momentum = momentum_gradient(system, unknown[0])
    return momentum - jnp.where(system.free[:, None] > 0, pushed, 0), residuals


def row_gradient(system: System, velocities: Array, impulses: Impulses) -> Pair:
    """What the extra rows are in it: J' lam (n, 3), with what is at a bound put on it, and what is left of the rows."""
    sides = without_cones(system.friction, sides_of(bounds_of(system, impulses), impulses))
    sides = without_room(system, velocities, impulses, sides)
    on_bound = placed_at_bounds(system.extra, system.friction, sides, impulses)
    pushed = jnp.zeros_like(velocities)
    residuals = OrderedDict()
    for name, rows in system.extra.items():
        lam, own = impulses[name], on_bound[name]
        pushed = pushed + rows.apply_transpose(own)
        between = rows.bias - rows.apply(velocities) - rows.compliance * lam
        if name in system.friction and system.friction[name].cone:
            radius = friction_radii(system.friction, on_bound)[name][:, 0]
            residuals[name] = cone_residual(lam, between, radius, width(system, rows))
        else:
            residuals[name] = jnp.where(sides[name] != 0, lam - own, between)
    return pushed, residuals


@lanes_in_turn
def solve_bounded(system: System, coarse: Array, guess: Pair, gradient: Array | None = None) -> tuple[Pair, SolveInfo]:
    """Velocities of free triples (n, 3), impulses of extra rows, and info; from a guess, its `gradient` if known."""
    free = system.free[:, None]
    start = guess[0] * free
    velocities = merged(system, start)
    names, terms, follow = tuple(system.extra), terms_at(system, velocities, guess[1]), following(system)
    gradient = momentum_gradient(system, start) if gradient is None else gradient
    minimize = _minimizer(system, coarse)
    (step, found), info = minimize(gradient, terms, system.tolerance, system.floor, follow)
    end, impulses = start + step * free, named(names, found)
    weak = weakly_active(system, merged(system, end), impulses)
    return (end, impulses), info.replace(weakly_active=weak)


def pair_tangent(system: System, coarse: Array, unknown: Pair) -> Callable[[Pair, Any], tuple[Pair, SolveInfo]]:
    """(right, tolerance) -> the solution with the derivative of `pair_gradient` at `unknown`, and info.

    Rows at a bound are held there, friction's at bounds that do not move: that derivative is symmetric.
    """
    names, held, minimize = tuple(system.extra), held_rows(system, unknown[1]), _minimizer(system, coarse)

    def solve(right: Pair, tolerance: Any) -> tuple[Pair, SolveInfo]:
        wanted = tuple(right[1].values())
        terms = tangent_terms(system, held, wanted)
        (velocities, impulses), info = minimize(-right[0], terms, tolerance, 0.0, None)
        return (velocities, named(names, map(jnp.where, held, wanted, impulses))), info

    return solve


def solve_pair_tangent(
    system: System, coarse: Array, unknown: Pair, right: Pair, matvec: Any, iterate: bool = False
) -> Pair:
    """Solve matvec(y) = right, the derivative of `pair_gradient` at `unknown` or its transpose; NaN where that fails.

    Without friction that is the symmetric solve. With friction bounds that move, the symmetric solve P preconditions
    stabilised biconjugate gradients on P matvec(y) = P right: few iterations, since only sliding rows are left. So it
    does where the system's matrix is only near the tangent: `iterate`.
    """
    given = system, coarse, unknown
    if not (system.friction or iterate):
        return or_nan(*unless_zero(lambda g, r: pair_tangent(*g)(r, g[0].tolerance), given, right))

    def solve(given: Any, right: Pair) -> tuple[Pair, SolveInfo]:
        system = given[0]
        symmetric = pair_tangent(*given)

        def precondition(residual: Pair) -> Pair:
            return symmetric(residual, 0.1 * system.tolerance)[0]

        found, info = bicgstab(matvec, right, precondition, tol=system.tolerance, max_iterations=100)
        good = info.residual <= jnp.sqrt(system.tolerance)
        return found, info.replace(status=jnp.where(good, int(Status.CONVERGED), info.status))

    return or_nan(*unless_zero(solve, given, right))


def weakly_active(system: System, velocities: Array, impulses: Impulses) -> Array:
    """Number of extra rows at a bound with no force against it, to within the tolerance.

    The scale is energy: that of the unbound motion, and of what the rows ask of it.
    """
    scalar, blocks = inverse_mass(system)
    boxes = []
    diagonals = {name: rows.diagonal(scalar, blocks) + rows.compliance for name, rows in system.extra.items()}
    square = inner(system.target, system.mass[:, None] * system.target)
    for name, rows in system.extra.items():
        square = square + jnp.sum((rows.bias - rows.apply(system.target)) ** 2 / diagonals[name])
    tolerance = jnp.maximum(system.tolerance, jnp.finfo(velocities.dtype).eps)
    threshold = 10 * tolerance * jnp.sqrt(square)
    lower, upper = bounds_of(system, impulses)
    for name, rows in system.extra.items():
        lam, root = impulses[name], jnp.sqrt(diagonals[name])
        gap = rows.apply(velocities) + rows.compliance * lam - rows.bias
        box = make_box(lam, lower[name], upper[name])
        boxes.append(box.divided(1 / root).weak(lam * root, gap / root, threshold))
    return sum(boxes[1:], start=boxes[0])


def _minimizer(system: System, coarse: Array) -> Any:
    """(gradient, terms, tolerance, absolute, follow) -> the semismooth solve, all in the user's order."""
    matrix, order = condensed_matrix(system), SolverOrder(system)
    rows = tuple(order.placed(each) for each in system.extra.values())
    diagonal = jnp.concatenate([matrix.diagonal_blocks, order.rigid_blocks])
    inverse = inverse_blocks(diagonal)
    local = tuple(local_compliance(each, inverse) for each in rows)
    product = order.product(matrix)
    if few(rows):
        precondition = _preconditioner(system, coarse, order, diagonal, rows)
    else:
        precondition = _tied_preconditioner(system, matrix, order, diagonal, rows)

    def with_rows(stiffness: tuple[Array, ...]) -> Callable[[Array], Array]:
        return stiffened(product, tuple(map(RowStiffness, rows, stiffness)))

    def solve(gradient: Array, terms: RowTerms, tolerance: Any, absolute: Any, follow: Any) -> Any:
        (step, impulses), info = minimize_with_rows(
            product,
            order.gathered(gradient),
            rows,
            terms.replace(local=local),
            precondition,
            tol=tolerance,
            max_iterations=system.max_iterations,
            absolute=absolute,
            follow=follow,
            stiffened=with_rows,
            sharpest=SHARPEST if few(rows) else SHARPEST_TIED,
        )
        return (order.scattered(step), impulses), info

    return solve


class SolverOrder:
    """All triples in the solver's order: nodes group by group, padded, then the rigid bodies' two triples each."""

    def __init__(self, system: System):
        self.system, self.pattern = system, system.pattern
        self.nodes, padded = self.pattern.place.shape[0], self.pattern.order.shape[0]
        rigid = system.mass.shape[0] - self.nodes
        self.count = padded + rigid
        self.place = jnp.concatenate([self.pattern.place, padded + jnp.arange(rigid, dtype=self.pattern.place.dtype)])

    @property
    def rigid_blocks(self) -> Array:
        """Masses and inertias of rigid bodies as blocks (2 b, 3, 3)."""
        inertia = self.system.inertia
        if inertia is None:
            return jnp.zeros((0, 3, 3), self.system.mass.dtype)
        mass = self.system.mass[self.nodes : self.nodes + inertia.shape[0]]
        return jnp.concatenate([mass[:, None, None] * jnp.eye(3, dtype=mass.dtype), inertia])

    def gathered(self, field: Array) -> Array:
        """(n, 3) in solver order; zero on padding."""
        return jnp.concatenate([self.pattern.gathered(field[: self.nodes]), field[self.nodes :]])

    def scattered(self, field: Array) -> Array:
        """A field in solver order as (n, 3)."""
        return gather(field, self.place)

    def product(self, matrix: BlockMatrix) -> Callable[[Array], Array]:
        """The product with the nodes' matrix and the rigid bodies' blocks."""
        if self.system.inertia is None:
            return matrix.apply
        split, blocks = self.pattern.order.shape[0], self.rigid_blocks
        return lambda x: jnp.concatenate([matrix.apply(x[:split]), contract("bij,bj->bi", blocks, x[split:])])

    def placed(self, rows: PointRows) -> PointRows:
        """The rows on unknowns in solver order, without their hold on what does not move."""
        moving = jnp.repeat(gather(self.system.free, rows.triples), 3, axis=1)[:, None]
        return rows.replace(
            triples=gather(self.place, rows.triples), jacobian=rows.jacobian * moving, unknowns=self.count
        )


def _preconditioner(
    system: System, coarse: Array, order: SolverOrder, diagonal: Array, rows: tuple[PointRows, ...]
) -> Any:
    """stiffness -> preconditioner: P = (D + J' k J)^-1 on the triples, and the coarse space seen through it.

    P + P D B D P, with D the diagonal blocks and B the coarse correction of the nodes without rows. P D takes out of
    the coarse modes what stiff rows forbid, so B, built once for all active sets, does not fight them. Volumetric rows
    shared by clusters are not in it: bodies near nu = 0.5 with extra rows take more iterations.
    """
    correction, split = coarse_correction(group_modes(system), coarse), order.pattern.order.shape[0]

    def weighted(field: Array) -> Array:
        return contract("nij,nj->ni", diagonal[:split], field)

    def build(stiffness: tuple[Array, ...]) -> Any:
        smooth = smoother(diagonal, tuple(map(RowStiffness, rows, stiffness)))

        def apply(residual: Array) -> Array:
            first = smooth(residual)
            modes = weighted(correction(weighted(first[:split])))
            return first + smooth(jnp.concatenate([modes, jnp.zeros_like(first[split:])]))

        return apply

    return build


def _tied_preconditioner(
    system: System, matrix: BlockMatrix, order: SolverOrder, diagonal: Array, rows: tuple[PointRows, ...]
) -> Any:
    """stiffness -> preconditioner for many rows between bodies: node blocks, and a coarse space with the rows in it."""
    modes = group_modes(system)
    space = coarse_space(modes, coarse_matrix(matrix, modes), order.rigid_blocks)

    def build(stiffness: tuple[Array, ...]) -> Any:
        kinds = tuple(map(RowStiffness, rows, stiffness))
        smooth, inverse = smoother(diagonal, kinds), space.inverse(kinds)
        return lambda residual: smooth(residual) + space.correction(inverse, residual)

    return build
