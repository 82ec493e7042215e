"""Groups solved by their constant matrices, inverted once, and tied by one multiplier a shared copy (FETI).

    A v + S' B' l = r,   B S v = 0:   B W B' l = B S A^-1 r,   W = S A^-1 S'
with S the shared copies, and B what a node's copies differ by from its first one. Farhat & Roux 1991. Groups turned
alike turn B W B' along: its inverse at rest, turned with the groups, is the preconditioner of the multipliers' solve.
 Inverses belong to the time step and constants that they were made for; where those have changed
since, conjugate gradients on the nodes take this for a preconditioner, and find the step's solution all the same.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import lanes_in_turn
from jaxfem.methods.assembled import stiffness_blocks
from jaxfem.methods.groupwise.plan import Groups
from jaxfem.methods.groupwise.system import GroupSystem
from jaxfem.methods.node_blocks import EXACT
from jaxfem.model import Model
from jaxfem.pytrees import Pytree
from jaxfem.solvers.implicit import or_nan
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo

Array = jax.Array


class Inverses(Pytree):
    """A^-1 of each group in its own frame, (G, 3 N, 3 N), its `columns` (G, 3 N, 3 S) of shared copies and W
    `interface` (G, 3 S, 3 S); (B W B')^-1 at rest, `tied` (3 m, 3 m); `limit` () [N/m] of the binding coefficient for
    steps of `dt` () [s]."""

    whole: Array
    columns: Array
    interface: Array
    tied: Array
    limit: Array
    dt: Array

    def limit_at(self, dt: Array) -> Array:
        """The limit for steps of another length: less for longer ones, as if masses alone resisted."""
        return self.limit * jnp.minimum(1, (self.dt / dt) ** 2)


class Prepared(Pytree):
    """A step's equations beside the inverses."""

    system: GroupSystem
    inverses: Inverses


@lanes_in_turn
def group_inverses(system: GroupSystem, model: Model, dt: Array) -> Inverses:
    """Inverses for a step of `dt`, without the limit of the binding coefficient."""
    groups = system.groups
    count, width = groups.nodes.shape
    scale = model.elements.replace(volumes=system.stiff)
    blocks = stiffness_blocks(scale, model.elements.gradients.transpose(2, 0, 1), system.lam, system.shear)
    at = groups.slots % width
    dense = jnp.zeros((count, width, width, 3, 3), blocks.dtype)
    dense = dense.at[groups.element[:, None, None], at[:, :, None], at[:, None, :]].add(blocks)
    moves = groups.free[:, :, None, None, None] & groups.free[:, None, :, None, None]
    own = jnp.where(groups.free, system.inertia, 1)[:, :, None, None, None] * jnp.eye(3, dtype=blocks.dtype)
    dense = jnp.where(moves, dense, 0) + jnp.eye(width, dtype=blocks.dtype)[:, :, None, None] * own
    matrix = dense.transpose(0, 1, 3, 2, 4).reshape(count, 3 * width, 3 * width)
    whole = jnp.linalg.inv(matrix)
    inside = whole.reshape(count, 3 * width, width, 3)
    columns = jnp.take_along_axis(inside, groups.shared[:, None, :, None], 2) * groups.real[:, None, :, None]
    most = groups.shared.shape[1]
    columns = columns.reshape(count, width, 3, 3 * most)
    rows = jnp.take_along_axis(columns, groups.shared[:, :, None, None], 1) * groups.real[:, :, None, None]
    interface = rows.reshape(count, 3 * most, 3 * most)
    tied = jnp.linalg.inv(_pair_matrix(groups, interface)) if groups.tied else jnp.zeros((0, 0), whole.dtype)
    columns = columns.reshape(count, 3 * width, 3 * most)
    return Inverses(whole, columns, interface, tied, jnp.asarray(jnp.inf, whole.dtype), dt)


def _pair_matrix(groups: Groups, interface: Array) -> Array:
    """B W B' with the groups as at rest, (3 m, 3 m)."""
    most = groups.shared.shape[1]
    blocks = interface.reshape(groups.count, most, 3, most, 3)

    def between(one: Array, two: Array) -> Array:
        found = blocks[(one // most)[:, None], (one % most)[:, None], :, (two % most)[None], :]
        return jnp.where(((one // most)[:, None] == (two // most)[None])[:, :, None, None], found, 0)

    first, other = groups.first, groups.other
    total = between(first, first) + between(other, other) - between(first, other) - between(other, first)
    return total.transpose(0, 2, 1, 3).reshape(3 * len(first), 3 * len(first))


def coefficient_limit(groups: Groups, inverses: Inverses, dt: Array) -> Array:
    """Stability limit of k, () [N/m]: 2 / (p dt^2 |W|), p copies a node at most; no rotation of a group changes |W|."""
    if not groups.tied:
        return inverses.limit
    interface = inverses.interface
    largest = jnp.max(jnp.linalg.eigvalsh(0.5 * (interface + interface.swapaxes(1, 2))))
    found: Array = 2 / (jnp.max(groups.copies) * dt**2 * largest)
    return found


def _turned(rotation: Array, field: Array) -> Array:
    return jnp.einsum("gij,gnj->gni", rotation, field, precision=EXACT)


def _applied(rotation: Array, matrix: Array, field: Array) -> Array:
    """R times `matrix` (G, 3 N, 3 K) times R' `field` (G, K, 3): (G, N, 3)."""
    inner = _turned(rotation.swapaxes(1, 2), field).reshape(len(field), -1)
    outer = jnp.einsum("gij,gj->gi", matrix, inner, precision=EXACT)
    return _turned(rotation, outer.reshape(len(field), -1, 3))


def differing(groups: Groups, shared: Array) -> Array:
    """Q: what shared copies (G, S, 3) differ by from their nodes' means."""
    held = shared * groups.real[:, :, None]
    sums = jnp.zeros((groups.copies.shape[0] + 1, 3), shared.dtype).at[groups.owner].add(held)
    mean = sums / jnp.append(groups.copies, 1)[:, None]
    return (held - mean[groups.owner]) * groups.real[:, :, None]


def _gaps(groups: Groups, shared: Array) -> Array:
    """B: from each node's first copy to its others, (m, 3), of shared copies (G, S, 3)."""
    flat = shared.reshape(-1, 3)
    return flat[groups.other] - flat[groups.first]


def _pushes(groups: Groups, pairs: Array) -> Array:
    """B' of (m, 3): on shared copies, (G, S, 3)."""
    flat = jnp.zeros((groups.shared.size, 3), pairs.dtype).at[groups.other].add(pairs).at[groups.first].add(-pairs)
    return flat.reshape(*groups.shared.shape, 3)


def shared_of(groups: Groups, field: Array) -> Array:
    """Shared copies (G, S, 3) of a field (G, N, 3)."""
    return jnp.take_along_axis(field, groups.shared[:, :, None], 1) * groups.real[:, :, None]


def tied_solution(given: Prepared, right: Array) -> tuple[Array, Array]:
    """Copies (G, N, 3) with A v = right but for the forces that make copies of a node one; and their gaps (G, S, 3)."""
    system, inverses = given.system, given.inverses
    groups, rotation = system.groups, system.rotation
    found = _applied(rotation, inverses.whole, right * groups.free[:, :, None])
    if not groups.tied:
        return found, jnp.zeros((groups.count, 0, 3), right.dtype)
    own = rotation[groups.first // groups.shared.shape[1]]

    def tied(pairs: Array) -> Array:
        return _gaps(groups, _applied(rotation, inverses.interface, _pushes(groups, pairs)))

    def nearly(pairs: Array) -> Array:
        inner = jnp.einsum("mji,mj->mi", own, pairs, precision=EXACT).reshape(-1)
        outer = jnp.einsum("ij,j->i", inverses.tied, inner, precision=EXACT).reshape(-1, 3)
        return jnp.einsum("mij,mj->mi", own, outer, precision=EXACT)

    digits = 1e-11 if right.dtype.itemsize > 4 else 1e-6
    apart = _gaps(groups, shared_of(groups, found))
    multipliers, _ = pcg(tied, apart, nearly, tol=digits, max_iterations=system.max_iterations)
    found = found - _applied(rotation, inverses.columns, _pushes(groups, multipliers))
    return found, differing(groups, shared_of(groups, found))


def nodes_of(system: GroupSystem, copies: Array) -> Array:
    """Means (n, 3) of the copies, by their masses."""
    return system.gathered(system.share[:, :, None] * copies)


def _refined(given: Prepared, right: Array, absolute: Array) -> tuple[Array, SolveInfo]:
    """A^-1 of a nodal right-hand side (n, 3)."""
    system = given.system

    def product(vector: Array) -> Array:
        moving = jnp.where(system.free, vector, 0)
        pulled = system.gathered(system.product(system.spread(moving) * (system.share > 0)[:, :, None]))
        return jnp.where(system.free, pulled, vector)

    def nearly(residual: Array) -> Array:
        split = system.share[:, :, None] * system.spread(residual)
        moved = nodes_of(system, tied_solution(given, split)[0])
        return jnp.where(system.free, moved, residual)

    return pcg(product, right, nearly, tol=system.tolerance, max_iterations=system.max_iterations, absolute=absolute)


@lanes_in_turn
def _exact(given: Prepared, guess: Array) -> tuple[Array, tuple[SolveInfo, Array]]:
    system = given.system
    guess = jnp.where(system.free, guess, 0)
    start = system.spread(system.merged(guess)) * (system.share > 0)[:, :, None]
    left = system.right - system.product(start)
    copies, gap = tied_solution(given, left)
    near = guess + jnp.where(system.free, nodes_of(system, copies), 0)
    # The step's own tolerance is of what the guess leaves, so that steps at rest end at rounding.
    size = jnp.linalg.norm(jnp.where(system.free, system.gathered(left), 0))
    target = jnp.maximum(system.tolerance * size, system.floor)
    rest = -system.gradient(near)
    increment, info = _refined(given, rest, target)
    share = jnp.linalg.norm(rest) / jnp.where(size > 0, size, 1)  # residuals are told relative to what was to be done
    info = info.replace(residual=info.residual * share)
    return near + jnp.where(system.free, increment, 0), (info, jnp.max(jnp.abs(gap), initial=0.0))


@lanes_in_turn
def _tangent(given: Prepared, right: Array) -> Array:
    return or_nan(*_refined(given, right, jnp.zeros_like(given.system.floor)))


@dataclasses.dataclass(frozen=True)
class ExactCondition:
    """Copies of a node are one: the condition on the nodes' velocities."""

    symmetric: bool = True

    def gradient(self, inputs: Prepared, unknown: Array) -> Array:
        """See `GroupSystem`."""
        return inputs.system.gradient(unknown)

    def solve(self, inputs: Prepared, guess: Array) -> tuple[Array, Any]:
        """By the inverses and multipliers; info, and the largest gap between copies [m/s]."""
        return _exact(inputs, guess)

    def tangent_solve(self, inputs: Prepared, unknown: Array, right: Array, matvec: Any) -> Array:
        """With the same matrix; fixed nodes' rows carry their masses."""
        system = inputs.system
        mass = system.gathered(jnp.broadcast_to(system.inertia[:, :, None], system.right.shape))
        return _tangent(inputs, jnp.where(system.free, right, right / mass))


@dataclasses.dataclass(frozen=True)
class CopiesCondition:
    """Each group by itself: A v = right on the copies that move; `inputs`: (prepared, right)."""

    symmetric: bool = True

    def gradient(self, inputs: tuple[Prepared, Array], unknown: Array) -> Array:
        """The residual (G, N, 3)."""
        given, right = inputs
        moves = given.system.groups.free[:, :, None]
        return jnp.where(moves, given.system.product(jnp.where(moves, unknown, 0)) - right, unknown)

    def solve(self, inputs: tuple[Prepared, Array], guess: Array) -> tuple[Array, SolveInfo]:
        """By the inverses, until nothing but rounding is left."""
        given, right = inputs
        moves = given.system.groups.free[:, :, None]
        return _copies(given, jnp.where(moves, right, 0))

    def tangent_solve(self, inputs: Any, unknown: Array, right: Array, matvec: Any) -> Array:
        """With the same inverses."""
        return or_nan(*_copies(inputs[0], right))


@lanes_in_turn
def _copies(given: Prepared, right: Array) -> tuple[Array, SolveInfo]:
    system, inverses = given.system, given.inverses
    moves = system.groups.free[:, :, None]

    def product(vector: Array) -> Array:
        return jnp.where(moves, system.product(jnp.where(moves, vector, 0)), vector)

    def nearly(residual: Array) -> Array:
        return jnp.where(moves, _applied(system.rotation, inverses.whole, residual * moves), residual)

    digits = 1e-13 if right.dtype.itemsize > 4 else 1e-6
    return pcg(product, right, nearly, tol=digits, max_iterations=system.max_iterations)
