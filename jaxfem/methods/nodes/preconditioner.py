"""Two-level preconditioner: inverse diagonal blocks, plus a coarse space of the rigid modes of node groups."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxfem.elements.pattern import Pattern
from jaxfem.indexing import gather
from jaxfem.methods.nodes.assembly import BlockMatrix
from jaxfem.methods.nodes.stiff import with_clusters
from jaxfem.solvers.dense import dense_inverse
from jaxfem.tensors import contract, determinant, inverse_blocks, matmul, matrix_of

Array = jax.Array


def rigid_modes(pattern: Pattern, positions: Array, free: Array, rotation: Array) -> Array:
    """Six rigid modes of each group at `positions` (n, 3), along the axes of its own frame: (groups, 3 size, 6).

    `rotation` (3, 3, D) of the domains. In its own frame a group's modes turn with it, so a coarse matrix built at one
    shape serves at others. Lengths are scaled by the group's radius; fixed nodes and padding take no part. A group of
    free nodes on one line has no rotations: they would not be independent of each other.
    """
    groups = pattern.frames.shape[0]
    frame = gather(jnp.moveaxis(rotation, -1, 0), pattern.frames)  # (groups, 3, 3), columns are the axes
    x = pattern.gathered(positions).reshape(groups, -1, 3)
    weight = pattern.gathered(free).reshape(groups, -1, 1)
    count = jnp.maximum(jnp.sum(weight, 1, keepdims=True), 1)
    arm = (x - jnp.sum(x * weight, 1, keepdims=True) / count) * weight
    radius = jnp.sqrt(jnp.sum(arm**2, (1, 2), keepdims=True) / count)
    arm = jnp.where(_off_a_line(arm), arm / jnp.where(radius > 0, radius, 1), 0)
    axes = jnp.broadcast_to(frame[:, None], (*arm.shape[:2], 3, 3))
    turns = jnp.cross(axes, arm[..., None], axisa=2, axisb=2, axisc=2)  # axis k x arm, in column k
    modes = jnp.concatenate([axes * weight[..., None], turns], -1)
    return modes.reshape(groups, -1, 6)


def _off_a_line(arm: Array) -> Array:
    """Whether arms (groups, size, 3) from their centres span more than a line: (groups, 1, 1)."""
    spread = contract("gai,gaj->gij", arm, arm)
    trace = jnp.trace(spread, axis1=1, axis2=2)
    # Product of the moments of inertia, the sums of two principal spreads.
    inertia = trace[:, None, None] * jnp.eye(3, dtype=arm.dtype) - spread
    return (determinant(matrix_of(jnp.moveaxis(inertia, 0, -1))) > 1e-5 * trace**3)[:, None, None]


def coarse_inverse(matrix: BlockMatrix, modes: Array) -> Array:
    """Inverse of Z'SZ, (6 groups, 6 groups)."""
    return inverse_of_coarse(coarse_matrix(matrix, modes))


def coarse_matrix(matrix: BlockMatrix, modes: Array) -> Array:
    """Z'SZ, (6 groups, 6 groups)."""
    groups, nodes = modes.shape[0], matrix.neighbours.shape[0]
    at = modes.reshape(nodes, 3, 6)
    width = matrix.neighbours.shape[1]
    gathered = gather(at, matrix.neighbours).reshape(nodes, 3 * width, 6)
    spread = matrix.blocks.reshape(nodes, 3, width, 3).transpose(0, 2, 1, 3)
    products = contract("nvij,nvjk->nvik", spread, gathered.reshape(nodes, width, 3, 6))
    blocks = contract("nil,nvik->nvlk", at, products)
    owner = jnp.arange(nodes) // (nodes // groups)
    coarse = jnp.zeros((groups, groups, 6, 6), blocks.dtype).at[owner[:, None], owner[matrix.neighbours]].add(blocks)
    coarse = coarse.transpose(0, 2, 1, 3).reshape(6 * groups, 6 * groups)
    return sum((factor.galerkin(modes) for factor in matrix.factors), start=coarse)


def inverse_of_coarse(coarse: Array) -> Array:
    """Inverse of a small dense matrix, scaled by its diagonal before it is factorised.

    An unknown that nothing holds gets 1 on its diagonal. Should the factorisation fail in rounding, zero: the coarse
    space is then left out.
    """
    diagonal = jnp.diagonal(coarse)
    scale = jnp.where(diagonal > 0, diagonal, 1) ** -0.5
    shift = 30 * jnp.finfo(coarse.dtype).eps
    scaled = coarse * scale[:, None] * scale + jnp.diag(jnp.where(diagonal > 0, shift, 1))
    inverse = dense_inverse(scaled) * scale[:, None] * scale
    return jnp.where(jnp.isfinite(inverse).all(), inverse, 0.0)


def two_level(matrix: BlockMatrix, modes: Array, inverse: Array) -> Callable[[Array], Array]:
    """r -> D^-1 r + Z (Z'SZ)^-1 Z' r on fields in solver order (N, 3); `inverse` may come from an earlier shape.

    Rows shared by clusters are left out of both and brought in by `with_clusters`.
    """
    blocks = inverse_blocks(matrix.diagonal_blocks)
    coarse = coarse_correction(modes, inverse)

    def apply(residual: Array) -> Array:
        return contract("nij,nj->ni", blocks, residual) + coarse(residual)

    precondition: Callable[[Array], Array] = apply
    for factor in matrix.factors:
        precondition = with_clusters(precondition, factor, blocks, modes, inverse)
    return precondition


def coarse_correction(modes: Array, inverse: Array) -> Callable[[Array], Array]:
    """r -> Z (Z'SZ)^-1 Z' r on fields in solver order (N, 3)."""
    groups = modes.shape[0]

    def apply(residual: Array) -> Array:
        restricted = contract("gal,ga->gl", modes, residual.reshape(groups, -1))
        coarse = matmul(inverse, restricted.reshape(-1)).reshape(groups, 6)
        return contract("gal,gl->ga", modes, coarse).reshape(residual.shape)

    return apply
