"""The groups' constant matrices, each in its own frame: made once for a time step and constants, and served turned."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import lanes_in_turn
from jaxfem.methods.assembled import stiffness_blocks
from jaxfem.methods.groupwise.plan import Groups
from jaxfem.methods.groupwise.system import GroupSystem
from jaxfem.model import Model
from jaxfem.pytrees import Pytree
from jaxfem.tensors import EXACT

Array = jax.Array


class Inverses(Pytree):
    """For groups by themselves: A^-1 of each, `whole` (G, 3 N, 3 N), and `limit` () [N/m] of the binding coefficient
    for steps of `dt` () [s]."""

    whole: Array
    limit: Array
    dt: Array

    def limit_at(self, dt: Array) -> Array:
        """The limit for steps of another length: less for longer ones, as if masses alone resisted."""
        return self.limit * jnp.minimum(1, (self.dt / dt) ** 2)


class Eliminated(Pytree):
    """For groups whose shared nodes are one: with i the I nodes of its own and s the S shared ones of a group,
    `inner` A_ii^-1 (G, 3 I, 3 I), `reach` X = A_ii^-1 A_is (G, 3 I, 3 S) and its transpose `seen` (stored, as products
    with it are as fast as memory lets them), the Schur complement `schur` A_ss - A_si X (G, 3 S, 3 S), and the inverse
    `tied` (3 H, 3 H) of their sum over all groups, turned as at rest: in single precision, as it only preconditions."""

    inner: Array
    reach: Array
    seen: Array
    schur: Array
    tied: Array


@lanes_in_turn
def group_inverses(system: GroupSystem, model: Model, dt: Array) -> Inverses:
    """Inverses for a step of `dt`, and the limit of the binding coefficient: see `coefficient_limit`."""
    groups = system.groups
    count, width = groups.nodes.shape
    matrix = _group_matrices(system, model)
    whole = jnp.linalg.inv(matrix.reshape(count, 3 * width, 3 * width))
    found = Inverses(whole, jnp.asarray(jnp.inf, whole.dtype), dt)
    return found.replace(limit=coefficient_limit(groups, whole, dt)) if groups.tied else found


def coefficient_limit(groups: Groups, whole: Array, dt: Array) -> Array:
    """Stability limit of k, () [N/m]: 2 / (p dt^2 |W|), W = S A^-1 S' of the shared copies S and p copies a node at
    most; no rotation of a group changes |W|."""
    count, width = groups.nodes.shape
    inverse = whole.reshape(count, width, 3, width, 3)
    interface = _part(inverse, groups.shared, groups.real, groups.shared, groups.real)
    largest = jnp.max(jnp.linalg.eigvalsh(0.5 * (interface + interface.swapaxes(1, 2))))
    found: Array = 2 / (jnp.max(groups.copies) * dt**2 * largest)
    return found


@lanes_in_turn
def eliminated(system: GroupSystem, model: Model) -> Eliminated:
    """The inner nodes of each group eliminated (static condensation, Guyan 1965; Przemieniecki 1963)."""
    groups, matrix = system.groups, _group_matrices(system, model)
    own, ties = (groups.inner, groups.within), (groups.shared, groups.real)
    inside = _part(matrix, *own, *own)
    # Rows of padding are zero: they are given a unit diagonal, and stay by themselves.
    blank = jnp.repeat(~groups.within, 3, axis=1).astype(inside.dtype)
    inner = jnp.linalg.inv(inside + blank[:, :, None] * jnp.eye(inside.shape[1], dtype=inside.dtype))
    across = _part(matrix, *own, *ties)
    reach = jnp.einsum("gij,gjk->gik", inner, across, precision=EXACT)
    seen = reach.swapaxes(1, 2)
    schur = _part(matrix, *ties, *ties) - jnp.einsum("gij,gjk->gik", seen, across, precision=EXACT)
    schur = 0.5 * (schur + schur.swapaxes(1, 2))
    return Eliminated(inner, reach, seen, schur, _tied_inverse(groups, schur))


def _group_matrices(system: GroupSystem, model: Model) -> Array:
    """A of each group in its own frame, (G, N, 3, N, 3); what does not move, and padding, by itself."""
    groups = system.groups
    count, width = groups.nodes.shape
    scale = model.elements.replace(volumes=system.span * system.reach)
    blocks = stiffness_blocks(scale, model.elements.gradients.transpose(2, 0, 1), system.lam, system.shear)
    at = groups.slots % width
    dense = jnp.zeros((count, width, width, 3, 3), blocks.dtype)
    dense = dense.at[groups.element[:, None, None], at[:, :, None], at[:, None, :]].add(blocks)
    moves = groups.free[:, :, None, None, None] & groups.free[:, None, :, None, None]
    own = jnp.where(groups.free, system.inertia, 1)[:, :, None, None, None] * jnp.eye(3, dtype=blocks.dtype)
    dense = jnp.where(moves, dense, 0) + jnp.eye(width, dtype=blocks.dtype)[:, :, None, None] * own
    return dense.transpose(0, 1, 3, 2, 4)


def _part(matrix: Array, rows: Array, in_rows: Array, columns: Array, in_columns: Array) -> Array:
    """The blocks of nodes `rows` (G, r) and `columns` (G, c) of (G, N, 3, N, 3): (G, 3 r, 3 c); zero on padding."""
    group = jnp.arange(len(matrix))[:, None, None]
    kept = in_rows[:, :, None] & in_columns[:, None, :]
    found = matrix[group, rows[:, :, None], :, columns[:, None, :]] * kept[:, :, :, None, None]
    return found.transpose(0, 1, 3, 2, 4).reshape(len(matrix), 3 * rows.shape[1], 3 * columns.shape[1])


def _tied_inverse(groups: Groups, schur: Array) -> Array:
    """(sum of the Schur complements with the groups as at rest)^-1, (3 H, 3 H)."""
    if not groups.tied:
        return jnp.zeros((0, 0), jnp.float32)
    count, most = len(groups.copies), groups.shared.shape[1]
    blocks = schur.reshape(groups.count, most, 3, most, 3).transpose(0, 1, 3, 2, 4)
    total: Any = jnp.zeros((count + 1, count + 1, 3, 3), schur.dtype)
    total = total.at[groups.owner[:, :, None], groups.owner[:, None, :]].add(blocks)[:count, :count]
    inverse: Array = jnp.linalg.inv(total.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)).astype(jnp.float32)
    return inverse
