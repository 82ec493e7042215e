"""The coupled step by projected Gauss-Seidel on its rows, with the true friction cone.

Each block of rows changes the velocities of its own few triples at once, so a sweep costs one visit of each row. Normal
impulses are used as they come, so friction needs no outer rounds, and a pair of tangential impulses is projected on the
disc of radius mu lam_n: the cone itself, where bounds on each of the two rows make a pyramid.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree
from jaxfem.rows.points import PointRows
from jaxfem.solvers import trees
from jaxfem.solvers.box import Box
from jaxfem.solvers.pgs import pgs_loop
from jaxfem.solvers.status import SolveInfo
from jaxfem.system.coupled import apply_inverse_mass, inverse_mass
from jaxfem.system.soft import System
from jaxfem.tensors import EIGENBASIS

Array = jax.Array
Impulses = tuple[Array, ...]


class _Blocks(Pytree):
    """Rows with what a unit impulse on each adds to their own triples, `response` (m, r, k, 3), and their diagonal."""

    rows: PointRows
    response: Array
    diagonal: Array


def search_by_sweeps(system: System, guess: Impulses, operator: Any, right: Impulses) -> tuple[Impulses, SolveInfo]:
    """Impulses of all rows, and info: an iteration is a sweep. `operator`, `right`: the product with A, and b."""
    inverse = inverse_mass(system)
    blocks = [_blocks(points_of(rows), inverse) for rows in system.rows]
    radii = {each.tangent: each for each in system.friction}

    def unpacked(impulses: Impulses) -> list[Array]:
        return [_turned(lam, rows) for lam, rows in zip(impulses, system.rows, strict=True)]

    def sweep(impulses: Impulses) -> Impulses:
        lams = unpacked(impulses)
        pushed = sum(
            (b.rows.apply_transpose(lam) for b, lam in zip(blocks, lams, strict=True)), start=0 * system.target
        )
        velocities = system.target + apply_inverse_mass(inverse, pushed)
        for number, each in enumerate(blocks):
            radius = None
            if number in radii:
                radius = radii[number].coefficient * jnp.maximum(lams[radii[number].normal][:, 0], 0)
            lams[number], velocities = _sweep_blocks(each, lams[number], velocities, radius)
        return tuple(_turned(lam, rows) for lam, rows in zip(lams, system.rows, strict=True))

    diagonal = tuple(_turned(b.diagonal, rows) for b, rows in zip(blocks, system.rows, strict=True))

    def projected(impulses: Impulses, gradient: Impulses) -> Impulses:
        return tuple(
            d * (lam - moved)
            for d, lam, moved in zip(
                diagonal, impulses, projected_step(system, impulses, gradient, diagonal), strict=True
            )
        )

    return pgs_loop(
        sweep,
        lambda x: trees.minus(operator(x), right),
        projected,
        right,
        projected_step(system, guess, trees.zeros(guess), diagonal),
        diagonal,
        tol=system.tolerance,
        max_iterations=system.max_iterations,
        weak=_weak(system),
    )


def projected_step(system: System, impulses: Impulses, gradient: Impulses, diagonal: Impulses) -> Impulses:
    """lam - D^-1 gradient put back into its bounds, and into discs of radius mu lam_n for friction."""
    moved = [lam - g / d for lam, g, d in zip(impulses, gradient, diagonal, strict=True)]
    for number, rows in enumerate(system.rows):
        if rows.bounds is not None and all(each.tangent != number for each in system.friction):
            moved[number] = jnp.clip(moved[number], *rows.bounds)
    for each in system.friction:
        width = jnp.max(diagonal[each.tangent], -1, keepdims=True)
        step = impulses[each.tangent] - gradient[each.tangent] / width
        moved[each.tangent] = into_disc(step, each.coefficient * jnp.maximum(impulses[each.normal][:, 0], 0))
    return tuple(moved)


def into_disc(pairs: Array, radius: Array) -> Array:
    """Pairs (m, 2) no longer than `radius` (m,)."""
    square = jnp.sum(pairs**2, -1)
    outside = square > radius**2
    length = jnp.sqrt(jnp.where(outside, square, 1))
    return jnp.where(outside, radius / length, 1)[:, None] * pairs


def points_of(rows: Any) -> PointRows:
    """Rows as blocks over a few triples each; elastic ones become one block a domain."""
    if isinstance(rows, PointRows):
        return rows
    domains = rows.domains
    basis = jnp.asarray(EIGENBASIS[domains.rows], rows.bias.dtype)
    turned = jnp.einsum("ije,rjk,ake->erai", rows.rotation, basis, domains.gradients)
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
            excess = rows.jacobian[i] @ v[at].reshape(-1) + rows.compliance[i] * own - rows.bias[i]
            new = into_disc((own - excess / jnp.max(blocks.diagonal[i]))[None], radius[i][None])[0]
            v = v.at[at].add(jnp.einsum("r,rki->ki", new - own, blocks.response[i]))
            return lams.at[i].set(new), v
        for r in range(own.shape[0]):
            excess = rows.jacobian[i, r] @ v[at].reshape(-1) + rows.compliance[i, r] * own[r] - rows.bias[i, r]
            best = own[r] - excess / blocks.diagonal[i, r]
            if low is not None and up is not None:
                best = jnp.clip(best, low[i, r], up[i, r])
            v = v.at[at].add((best - own[r]) * blocks.response[i, r])
            own = own.at[r].set(best)
        return lams.at[i].set(own), v

    return jax.lax.fori_loop(0, lams.shape[0], visit, (lams, velocities))


def _blocks(rows: PointRows, inverse: tuple[Array, Array | None]) -> _Blocks:
    scalar, turning = inverse
    m, r, _ = rows.jacobian.shape
    parts = rows.jacobian.reshape(m, r, -1, 3)
    response = parts * scalar[rows.triples][:, None, :, None]
    if turning is not None:
        first = rows.unknowns - turning.shape[0]
        own = jnp.where((rows.triples >= first)[:, :, None, None], turning[jnp.maximum(rows.triples - first, 0)], 0)
        response = response + jnp.einsum("mkij,mrkj->mrki", own, parts)
    return _Blocks(rows, response, rows.diagonal(scalar, turning) + rows.compliance)


def _turned(values: Array, rows: Any) -> Array:
    """From the rows' own layout to blocks first, or back: elastic rows are kept as (r, D)."""
    return values if isinstance(rows, PointRows) else values.T


def _weak(system: System) -> Any:
    """Rows at a bound without force against it; pairs in a disc are not counted."""
    frictional = {each.tangent for each in system.friction}
    bounds = [None if n in frictional else rows.bounds for n, rows in enumerate(system.rows)]
    box = Box(*(tuple(None if b is None else b[side] for b in bounds) for side in (0, 1)))
    return box.weak
