"""Groups whose copies of a node are one: inner nodes eliminated group by group, the shared ones solved for together.

With a group's nodes split into its own (i) and those it shares (s), and its matrices in its own frame (`Eliminated`),
    sum_j R_j S_j R_j' v_s = r_s - sum_j R_j X_j' R_j' r_i,      v_i = R_j (A_ii^-1 R_j' r_i - X_j R_j' v_s).
Only the small system of the shared nodes changes from step to step, with the groups' rotations. Conjugate gradients
solve it; their preconditioner is its inverse at rest, turned with the groups: where groups turn alike it is exact.
The matrices belong to the time step and constants that they were made for; where those have changed since, conjugate
gradients on all nodes take this for a preconditioner, and find the step's solution all the same.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import cond_any, lanes_in_turn
from jaxfem.methods.groupwise.matrices import Eliminated
from jaxfem.methods.groupwise.plan import Groups
from jaxfem.methods.groupwise.system import GroupSystem
from jaxfem.pytrees import Pytree
from jaxfem.rotation import nearest_rotation
from jaxfem.solvers.implicit import or_nan
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo
from jaxfem.tensors import EXACT

Array = jax.Array
SHARE = 0.5
"""Of the residual that ends a step: what the shared nodes' solve may leave."""


class Prepared(Pytree):
    """A step's equations beside the matrices that serve them."""

    system: GroupSystem
    matrices: Any


def turned(rotation: Array, field: Array) -> Array:
    """R of each group times its (G, k, 3)."""
    return jnp.einsum("gij,gnj->gni", rotation, field, precision=EXACT)


def times_flat(matrix: Array, field: Array) -> Array:
    """Matrices (G, 3 r, 3 c) times (G, c, 3): (G, r, 3)."""
    found = jnp.einsum("gij,gj->gi", matrix, field.reshape(len(field), -1), precision=EXACT)
    return found.reshape(len(field), -1, 3)


def condensed_solution(given: Prepared, right: Array, target: Array | None) -> tuple[Array, Array]:
    """Velocities (n, 3) for a nodal right-hand side (n, 3), by the equations above, and iterations taken.

    The shared nodes' residual is brought to `target`; None: by one product with their inverse at rest, which makes all
    of it one symmetric operator.
    """
    system, matrices = given.system, given.matrices
    groups, forth = system.groups, system.rotation
    back = forth.swapaxes(1, 2)
    own = turned(back, right[jnp.take_along_axis(groups.nodes, groups.inner, 1)] * groups.within[:, :, None])
    alone = times_flat(matrices.inner, own)
    if not groups.tied:
        return _on_nodes(groups, turned(forth, alone), right[groups.met]), jnp.int32(0)
    left = right[groups.met] - _summed(groups, turned(forth, times_flat(matrices.seen, own)))
    nearly = _turned_inverse(groups, matrices, forth)
    if target is None:
        met, count = nearly(left), jnp.int32(0)
    else:
        product = _interface(groups, matrices, forth, back)
        met, info = pcg(product, left, nearly, tol=0.0, absolute=target, max_iterations=system.max_iterations)
        count = info.iterations
    pulled = times_flat(matrices.reach, turned(back, _copied(groups, met)))
    return _on_nodes(groups, turned(forth, alone - pulled), met), count


def _interface(groups: Groups, matrices: Eliminated, forth: Array, back: Array) -> Callable[[Array], Array]:
    def product(met: Array) -> Array:
        return _summed(groups, turned(forth, times_flat(matrices.schur, turned(back, _copied(groups, met)))))

    return product


def _turned_inverse(groups: Groups, matrices: Eliminated, forth: Array) -> Callable[[Array], Array]:
    # Between the frames of the groups that meet: in one of theirs all the others would be twice as far off.
    between = jnp.einsum("qg,gij->qij", groups.sides, forth, precision=EXACT)
    frame = nearest_rotation(between)[groups.side]

    def nearly(left: Array) -> Array:
        # Scaled, so that what is small in double precision does not vanish in single.
        size = jnp.max(jnp.abs(left))
        unit = left / jnp.where(size > 0, size, 1)
        inner = jnp.einsum("mji,mj->mi", frame, unit, precision=EXACT).reshape(-1)
        single = jnp.einsum("ij,j->i", matrices.tied, inner.astype(matrices.tied.dtype), precision=EXACT)
        return size * jnp.einsum("mij,mj->mi", frame, single.astype(left.dtype).reshape(-1, 3), precision=EXACT)

    return nearly


def _copied(groups: Groups, met: Array) -> Array:
    """A field of the shared nodes (H, 3) on their copies (G, S, 3)."""
    return met[groups.owner] * groups.real[:, :, None]  # beyond the last one: the last, times zero


def _summed(groups: Groups, shared: Array) -> Array:
    """Sums (H, 3) of shared copies (G, S, 3)."""
    return jnp.zeros((len(groups.copies) + 1, 3), shared.dtype).at[groups.owner].add(shared)[:-1]


def _on_nodes(groups: Groups, inner: Array, met: Array) -> Array:
    """(n, 3) of inner nodes (G, I, 3) and shared ones (H, 3); zero where nothing moves."""
    every = jnp.concatenate([inner.reshape(-1, 3), met, jnp.zeros((1, 3), met.dtype)])
    return every[groups.place]


def _solved(given: Prepared, right: Array, target: Array) -> tuple[Array, SolveInfo]:
    """A^-1 of a nodal right-hand side (n, 3) of the free nodes, to a residual of `target`."""
    system = given.system
    first, count = condensed_solution(given, right, SHARE * target)
    rest = right - jnp.where(system.free, system.product(first), 0)
    left, size = jnp.linalg.norm(rest), jnp.linalg.norm(right)
    # A branch: a loop would have the matrices copied also where it has nothing to do.
    none = jnp.int32(0)
    good = SolveInfo(none, none, left, none)
    more, info = cond_any(~(left <= target), _refined, lambda *_: (jnp.zeros_like(rest), good), given, rest, target)
    relative = info.residual / jnp.where(size > 0, size, 1)
    return first + more, info.replace(iterations=info.iterations + count, residual=relative)


def _refined(given: Prepared, rest: Array, target: Array) -> tuple[Array, SolveInfo]:
    """What matrices that are out of date left (n, 3), by conjugate gradients on all nodes; `info.residual` [N s]."""
    system = given.system

    def product(vector: Array) -> Array:
        return jnp.where(system.free, system.product(vector), vector)

    def nearly(residual: Array) -> Array:
        return jnp.where(system.free, condensed_solution(given, residual, None)[0], residual)

    more, info = pcg(product, rest, nearly, tol=0.0, absolute=target, max_iterations=system.max_iterations)
    return jnp.where(system.free, more, 0), info.replace(residual=info.residual * jnp.linalg.norm(rest))


@lanes_in_turn
def _step_solution(given: Prepared, guess: Array) -> tuple[Array, SolveInfo]:
    system = given.system
    guess = jnp.where(system.free, guess, 0)
    # The tolerance is of what the guess leaves, so that steps at rest end at rounding.
    right = -jnp.where(system.free, system.gradient(guess), 0)
    target = jnp.maximum(system.tolerance * jnp.linalg.norm(right), system.floor)
    increment, info = _solved(given, right, target)
    return guess + increment, info


@lanes_in_turn
def _tangent(given: Prepared, right: Array) -> Array:
    system = given.system
    moving = jnp.where(system.free, right, 0)
    found, info = _solved(given, moving, system.tolerance * jnp.linalg.norm(moving))
    return or_nan(jnp.where(system.free, found, right / system.mass[:, None]), info)


@dataclasses.dataclass(frozen=True)
class ExactCondition:
    """Copies of a node are one: the condition on the nodes' velocities."""

    symmetric: bool = True

    def gradient(self, inputs: Prepared, unknown: Array) -> Array:
        """See `GroupSystem`."""
        return inputs.system.gradient(unknown)

    def solve(self, inputs: Prepared, guess: Array) -> tuple[Array, SolveInfo]:
        """From the last velocities."""
        return _step_solution(inputs, guess)

    def tangent_solve(self, inputs: Prepared, unknown: Array, right: Array, matvec: Any) -> Array:
        """With the same matrices; fixed nodes' rows carry their masses."""
        return _tangent(inputs, right)
