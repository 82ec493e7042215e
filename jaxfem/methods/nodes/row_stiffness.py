"""Approximate inverses of D + J' k J: node blocks D, and rows of stiffness k over a few nodes each."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from jaxfem.indexing import gather
from jaxfem.pytrees import Pytree
from jaxfem.rows.points import PointRows
from jaxfem.solvers.dense import dense_inverse
from jaxfem.tensors import contract, inverse_blocks, matmul

Array = jax.Array

MOST_EXACT = 192
"""Rows over several nodes that are treated exactly, by one small dense matrix; more are treated node by node."""


class RowStiffness(Pytree):
    """Rows on unknowns in solver order, and the stiffness (m, r) of each: zero where it is out of play."""

    rows: PointRows
    stiffness: Array

    @property
    def single(self) -> bool:
        """Whether each block acts on one node."""
        return self.rows.triples.shape[1] == 1

    def node_blocks(self) -> Array:
        """Diagonal 3x3 blocks of J' k J at each block's nodes, (m, k, 3, 3)."""
        parts = _parts(self.rows)
        return contract("mrai,mr,mraj->maij", parts, self.stiffness, parts)


def local_compliance(rows: PointRows, inverse: Array) -> Array:
    """What a unit impulse on each row moves it by, its nodes taken alone: sum_a J_a D_a^-1 J_a', (m, r)."""
    parts = _parts(rows)
    return contract("mrai,maij,mraj->mr", parts, gather(inverse, rows.triples), parts)


def stiffened(matvec: Callable[[Array], Array], kinds: Sequence[RowStiffness]) -> Callable[[Array], Array]:
    """x -> S x + J' k J x on fields (N, 3): rows on one node each as one block a node, without a scatter a product."""
    single = [kind for kind in kinds if kind.single]
    several = [kind for kind in kinds if not kind.single]
    blocks = jnp.zeros((kinds[0].rows.unknowns, 3, 3), kinds[0].stiffness.dtype)
    for kind in single:
        blocks = blocks.at[kind.rows.triples].add(kind.node_blocks())

    def apply(x: Array) -> Array:
        product = matvec(x)
        if single:
            product = product + contract("nij,nj->ni", blocks, x)
        for kind in several:
            product = product + kind.rows.apply_transpose(kind.stiffness * kind.rows.apply(x))
        return product

    return apply


def few(rows: Sequence[PointRows]) -> bool:
    """Whether rows over several nodes are few enough to be treated exactly."""
    return sum(each.bias.size for each in rows if each.triples.shape[1] > 1) <= MOST_EXACT


def smoother(diagonal: Array, kinds: Sequence[RowStiffness]) -> Callable[[Array], Array]:
    """r -> (D + J' k J)^-1 r on fields (N, 3): exact for rows on one node each, and for few others."""
    several = [kind for kind in kinds if not kind.single]
    exact = bool(several) and few([kind.rows for kind in several])
    blocks = diagonal
    for kind in kinds:
        if kind.single or not exact:
            blocks = blocks.at[kind.rows.triples].add(kind.node_blocks())
    inverse = inverse_blocks(blocks)

    def simple(residual: Array) -> Array:
        return contract("nij,nj->ni", inverse, residual)

    return _with_rows(simple, inverse, several) if exact else simple


def _with_rows(
    simple: Callable[[Array], Array], inverse: Array, kinds: Sequence[RowStiffness]
) -> Callable[[Array], Array]:
    """Woodbury: B - B J' (J B J' + 1/k)^-1 J B with B `simple`; scaled by sqrt(k), so that k may be zero."""
    roots = [jnp.sqrt(kind.stiffness) for kind in kinds]
    matrix = _row_matrix(inverse, kinds, roots)
    middle = dense_inverse(matrix + jnp.eye(matrix.shape[0], dtype=matrix.dtype))
    sizes = [root.size for root in roots]

    def apply(residual: Array) -> Array:
        first = simple(residual)
        seen = [(root * kind.rows.apply(first)).ravel() for root, kind in zip(roots, kinds, strict=True)]
        solved, pushed, at = matmul(middle, jnp.concatenate(seen)), jnp.zeros_like(residual), 0
        for root, kind, size in zip(roots, kinds, sizes, strict=True):
            pushed = pushed + kind.rows.apply_transpose(root * solved[at : at + size].reshape(root.shape))
            at += size
        return first - simple(pushed)

    return apply


def _row_matrix(inverse: Array, kinds: Sequence[RowStiffness], roots: Sequence[Array]) -> Array:
    """sqrt(k) J B J' sqrt(k), (M, M) over the rows of all kinds, in the fields of the nodes that they touch only."""
    nodes = jnp.concatenate([kind.rows.triples.ravel() for kind in kinds])
    count = nodes.shape[0]
    # One of its places in `nodes` stands for each node.
    spot = jnp.zeros(inverse.shape[0], jnp.int32).at[nodes].set(jnp.arange(count, dtype=jnp.int32))
    compact = [kind.rows.replace(triples=spot[kind.rows.triples], unknowns=count) for kind in kinds]
    own = inverse[nodes]
    columns = []
    for rows, root in zip(compact, roots, strict=True):
        m, r, _ = rows.jacobian.shape
        at = jnp.repeat(rows.triples, r, axis=0)
        weights = (rows.jacobian * root[:, :, None]).reshape(m * r, -1, 3)
        field = jnp.zeros((m * r, count, 3), weights.dtype).at[jnp.arange(m * r)[:, None], at].add(weights)
        columns.append(contract("nij,mnj->mni", own, field))
    fields = jnp.concatenate(columns)
    made = [
        jax.vmap(lambda field, rows=rows, root=root: (root * rows.apply(field)).ravel())(fields)
        for rows, root in zip(compact, roots, strict=True)
    ]
    return jnp.concatenate(made, axis=1)


def _parts(rows: PointRows) -> Array:
    m, r, _ = rows.jacobian.shape
    return rows.jacobian.reshape(m, r, -1, 3)
