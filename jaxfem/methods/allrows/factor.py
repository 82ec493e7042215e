"""The matrix A = J M^-1 J' + C of all rows, assembled in small blocks and factorised; see `order.py` for the order.

In variables scaled so that A has a unit diagonal. Rows out of play (at a bound) leave the matrix: theirs becomes that
of the identity, and the order stays as it is.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxfem.indexing import gather, with_last
from jaxfem.methods.allrows.flat import FlatRows
from jaxfem.methods.allrows.order import RowOrder, row_order
from jaxfem.rigid.dynamics import RigidSet
from jaxfem.solvers.elimination import factorise, product, solve_factored

Array = jax.Array


def row_preconditioner(order: RowOrder, rows: FlatRows, inside: Array) -> Callable[[Array], Array]:
    """r -> A_FF^-1 r on the rows F `inside` their bounds (1, else 0; (R,)), in scaled variables (D^-1/2 A D^-1/2); the
    others pass unchanged.

    The identity where the factorisation fails in rounding.
    """
    scale = inside * rows.diagonal**-0.5
    own = rows.compliance * scale**2 + (1 - inside)
    factor = factorise(order.elimination, *_blocks(order, rows, scale, _packed(order, own, 1.0)))
    sound = jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(factor)]).all()

    def apply(residual: Array) -> Array:
        found = solve_factored(order.elimination, factor, _packed(order, residual, 0.0))
        return jnp.where(sound, gather(found.reshape(-1), order.places), residual)

    return apply


def _blocks(order: RowOrder, rows: FlatRows, scale: Array, own: Array) -> tuple[Array, Array]:
    """Diagonal blocks (N, s, s) and those of the coupled pairs (P, s, s); `own` (N, s) is added to the diagonal."""
    count, size, width, repeats = order.parts.shape
    scales = rows.split(scale)
    jacobian = jnp.concatenate(
        [(each.jacobian * scales[name][:, :, None]).reshape(-1, 3) for name, each in rows.groups.items()]
    )
    jacobian = jnp.concatenate([jacobian, jnp.zeros((1, 3), jacobian.dtype)])
    entries = sum(gather(jacobian, order.parts[..., q]) for q in range(repeats))  # (N, s, t, 3)
    entries = jnp.moveaxis(entries, 1, 2).reshape(count * width, size, 3)
    moved = jnp.moveaxis(entries, 0, -1)  # (s, 3, N t)
    pushed = product(moved, jnp.moveaxis(gather(_inverse_mass_blocks(rows), order.triples.reshape(-1)), 0, -1))
    ends = jnp.zeros((1, size, 3), entries.dtype)
    table, pushed_table = jnp.concatenate([entries, ends]), jnp.concatenate([jnp.moveaxis(pushed, -1, 0), ends])
    diagonal = (
        sum(product(pushed[:, :, t::width], moved[:, :, t::width].swapaxes(0, 1)) for t in range(width))
        + own.T[:, None] * jnp.eye(size, dtype=own.dtype)[:, :, None]
    )
    beside = jnp.zeros((size, size, order.shared.shape[0]), own.dtype)
    for h in range(order.shared.shape[1]):
        first = jnp.moveaxis(gather(pushed_table, order.shared[:, h, 0]), 0, -1)
        second = jnp.moveaxis(gather(table, order.shared[:, h, 1]), 0, -1)
        beside = beside + product(first, second.swapaxes(0, 1))
    return jnp.moveaxis(diagonal, -1, 0), jnp.moveaxis(beside, -1, 0)


def _inverse_mass_blocks(rows: FlatRows) -> Array:
    """Inverse mass of each triple, (n + 1, 3, 3); zero in the last."""
    scalar, turning = rows.inverse
    blocks = jnp.append(scalar, 0)[:, None, None] * jnp.eye(3, dtype=scalar.dtype)
    if turning is None:
        return blocks
    return with_last(blocks, jnp.concatenate([turning, jnp.zeros((1, 3, 3), turning.dtype)]))


def _packed(order: RowOrder, values: Array, padding: float) -> Array:
    """Values of all rows as (N, s)."""
    return gather(jnp.append(values, padding), order.rows)


def elimination_of(triples: Sequence[np.ndarray], heights: Sequence[int], rigid: RigidSet) -> RowOrder | None:
    """The order for rows of rigid bodies alone, kind by kind; None where there are none, or it would be too dear.

    `triples` (m, k) that each kind of rows acts on, and the rows a block, `heights`.
    """
    if not triples:
        return None
    body_of = np.where(np.tile(np.asarray(rigid.free) > 0, 2), np.arange(2 * rigid.count) % rigid.count, -1)
    return row_order(triples, heights, body_of)
