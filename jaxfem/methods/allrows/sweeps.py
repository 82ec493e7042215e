"""The coupled step by projected Gauss-Seidel on its rows, with the true friction cone.

Each block of rows changes the velocities of its own few triples at once, so a sweep costs one visit of each row. Normal
impulses are used as they come, so friction needs no outer rounds, and a pair of tangential impulses is projected on the
disc of radius mu lam_n: the cone itself, where bounds on each of the two rows make a pyramid.
"""

import dataclasses
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxfem.elements.strains import PLAIN
from jaxfem.indexing import gather
from jaxfem.methods.allrows.condition import Found, solve_rows
from jaxfem.methods.allrows.cone import projected_step
from jaxfem.methods.allrows.operator import RowOperator
from jaxfem.methods.base import Facts, Solved
from jaxfem.methods.by_rows import RowMethod
from jaxfem.pytrees import Pytree
from jaxfem.rows.bounds import Bounds, Impulses, into_disc, named, row_bounds, sides_of
from jaxfem.rows.points import PointRows
from jaxfem.solvers import trees
from jaxfem.solvers.box import Box
from jaxfem.solvers.pgs import pgs_loop
from jaxfem.system.coupled import apply_inverse_mass
from jaxfem.system.soft import System
from jaxfem.tensors import EIGENBASIS, contract, matmul

Array = jax.Array


class _Blocks(Pytree):
    """Rows with what a unit impulse on each adds to their own triples, `response` (m, r, k, 3), and their diagonal."""

    rows: PointRows
    response: Array
    diagonal: Array


class Pgs(RowMethod):
    """Projected Gauss-Seidel on all rows, friction in the true cone: the baseline of real-time engines."""

    name: ClassVar[str] = "pgs"

    def refuses(self, facts: Facts) -> str | None:
        """Soft bodies alone, and rows that are not those of single elements."""
        if not facts.coupled:
            return 'is for scenes with rigid bodies, joints or contacts: use "auto" here'
        if facts.smoothed:
            return f'visits rows of single elements: use strain = "{PLAIN}", or another solver'
        return None

    def solve(self, system: System, plan: Any, cache: Any, velocities: Array, impulses: Impulses | None) -> Solved:
        """All rows, one after the other."""
        assert impulses is not None
        return solve_rows(system, plan, impulses, SweepSearch())


@dataclasses.dataclass(frozen=True)
class SweepSearch:
    """Sweeps over the rows until they fit; an iteration is a sweep."""

    cone: ClassVar[bool] = True

    def found(self, system: System, plan: Any, operator: RowOperator, guess: Impulses) -> Found:
        """Impulses and their sides; pairs in a disc are at none."""
        blocks = {name: _blocks(points_of(rows), operator.inverse) for name, rows in system.rows.items()}
        diagonal = named(blocks, (_turned(b.diagonal, system.rows[name]) for name, b in blocks.items()))

        def projected(impulses: Impulses, gradient: Impulses) -> Impulses:
            moved = projected_step(system, impulses, gradient, diagonal)
            residual: Impulses = jax.tree.map(lambda d, lam, new: d * (lam - new), diagonal, impulses, moved)
            return residual

        found, info = pgs_loop(
            partial(_sweep, system, blocks, operator.inverse),
            lambda x: trees.minus(operator.apply(x), operator.right),
            projected,
            operator.right,
            projected_step(system, guess, trees.zeros(guess), diagonal),
            diagonal,
            tol=system.tolerance,
            max_iterations=system.max_iterations,
            weak=Box(*(tuple(side.values()) for side in _own_bounds(system))).weak,
        )
        return Found(found, sides_of(_own_bounds(system), found), info)


def _sweep(system: System, blocks: dict[str, "_Blocks"], inverse: Any, impulses: Impulses) -> Impulses:
    """One visit of each row; velocities follow at once."""
    rows = system.rows
    lams = {name: _turned(lam, rows[name]) for name, lam in impulses.items()}
    parts = (each.rows.apply_transpose(lams[name]) for name, each in blocks.items())
    velocities = system.target + apply_inverse_mass(inverse, sum(parts, start=0 * system.target))
    for name, each in blocks.items():
        radius = None
        if name in system.friction:
            tied = system.friction[name]
            radius = tied.coefficient * jnp.maximum(lams[tied.normal][:, 0], 0)
        lams[name], velocities = _sweep_blocks(each, lams[name], velocities, radius)
    return named(impulses, (_turned(lams[name], rows[name]) for name in impulses))


def _own_bounds(system: System) -> Bounds:
    """Bounds of all rows, none for pairs in a disc."""
    low, up = row_bounds(system.rows, {})
    for name in system.friction:
        low[name] = up[name] = None
    return low, up


def points_of(rows: Any) -> PointRows:
    """Rows as blocks over a few triples each; elastic ones become one block a domain."""
    if isinstance(rows, PointRows):
        return rows
    domains = rows.domains
    basis = jnp.asarray(EIGENBASIS[domains.rows], rows.bias.dtype)
    turned = contract("ije,rjk,ake->erai", rows.rotation, basis, domains.gradients)
    jacobian = turned.reshape(*turned.shape[:2], -1)
    compliance = jnp.broadcast_to(rows.compliance, rows.bias.shape)
    return PointRows(domains.cells, jacobian, compliance.T, rows.bias.T, unknowns=rows.nodes)


def _sweep_blocks(blocks: _Blocks, lams: Array, velocities: Array, radius: Array | None) -> tuple[Array, Array]:
    rows = blocks.rows
    low, up = rows.bounds if rows.bounds is not None else (None, None)

    def visit(i: Any, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        lams, v = carry
        at, own = rows.triples[i], lams[i]
        if radius is not None:
            excess = matmul(rows.jacobian[i], v[at].reshape(-1)) + rows.compliance[i] * own - rows.bias[i]
            new = into_disc((own - excess / jnp.max(blocks.diagonal[i]))[None], radius[i][None])[0]
            v = v.at[at].add(contract("r,rki->ki", new - own, blocks.response[i]))
            return lams.at[i].set(new), v
        for r in range(own.shape[0]):
            excess = matmul(rows.jacobian[i, r], v[at].reshape(-1)) + rows.compliance[i, r] * own[r] - rows.bias[i, r]
            best = own[r] - excess / blocks.diagonal[i, r]
            if low is not None and up is not None:
                best = jnp.clip(best, low[i, r], up[i, r])
            v = v.at[at].add((best - own[r]) * blocks.response[i, r])
            own = own.at[r].set(best)
        return lams.at[i].set(own), v

    swept: tuple[Array, Array] = jax.lax.fori_loop(0, lams.shape[0], visit, (lams, velocities))
    return swept


def _blocks(rows: PointRows, inverse: tuple[Array, Array | None]) -> _Blocks:
    scalar, turning = inverse
    m, r, _ = rows.jacobian.shape
    parts = rows.jacobian.reshape(m, r, -1, 3)
    response = parts * gather(scalar, rows.triples)[:, None, :, None]
    if turning is not None:
        first = rows.unknowns - turning.shape[0]
        own = jnp.where((rows.triples >= first)[:, :, None, None], turning[jnp.maximum(rows.triples - first, 0)], 0)
        response = response + contract("mkij,mrkj->mrki", own, parts)
    return _Blocks(rows, response, rows.diagonal(scalar, turning) + rows.compliance)


def _turned(values: Array, rows: Any) -> Array:
    """From the rows' own layout to blocks first, or back: elastic rows are kept as (r, D)."""
    return values if isinstance(rows, PointRows) else values.T
