"""The binding iteration of Wang, Xu & Hasegawa, (11) and (12): groups by themselves, drawn together by a coefficient k.

A_j v_j = r_j + dt f_j,      f_j <- f_j + k sum_l (x_l - x_j) over a node's copies
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.batching import lanes_in_turn
from jaxfem.methods.groupwise.plan import Groups
from jaxfem.methods.groupwise.solve import Prepared, times_flat, turned
from jaxfem.solvers.implicit import implicit_solution, or_nan
from jaxfem.solvers.pcg import pcg
from jaxfem.solvers.status import SolveInfo

Array = jax.Array


def bound_solution(
    given: Prepared, coefficient: Array, rounds: int, dt: Array
) -> tuple[tuple[Array, Array], SolveInfo]:
    """Velocities (n, 3) after the rounds with the coefficient [N/m], from no binding force, beside the largest
    speed [m/s] of a copy against the mean of its node's; and info. `info.residual`: those speeds as a share of all."""
    system = given.system
    groups = system.groups
    force = jnp.zeros((*groups.shared.shape, 3), system.load.dtype)
    push = dt * jnp.append(groups.copies, 1)[groups.owner][:, :, None] * coefficient
    right = system.copies_right()

    def round_(force: Array, _: None) -> tuple[Array, SolveInfo]:
        copies, info = _separate(given, right, dt * force)
        # (12) with its sign turned: as printed it drives the copies apart. Times p (mean - x_j) = sum (x_l - x_j).
        return force - push * differing(groups, shared_of(groups, copies)), info

    force, infos = jax.lax.scan(round_, force, None, length=rounds - 1)
    copies, info = _separate(given, right, dt * force)
    apart = differing(groups, shared_of(groups, copies))
    size = jnp.linalg.norm(copies)
    share = jax.lax.stop_gradient(jnp.linalg.norm(apart) / jnp.where(size > 0, size, 1))
    worst = jnp.maximum(jnp.max(infos.status, initial=0), info.status)
    told = SolveInfo(worst, jnp.sum(infos.iterations) + info.iterations, share, jnp.int32(0))
    return (system.merged(system.means(copies)), jnp.max(jnp.abs(apart), initial=0.0)), told


def _separate(given: Prepared, right: Array, pushes: Array) -> tuple[Array, SolveInfo]:
    """Velocities of the copies (G, N, 3), each group by itself, with impulses (G, S, 3) on shared copies."""
    system, groups = given.system, given.system.groups
    moves = groups.free[:, :, None]
    held = jnp.where(moves, 0, system.spread(system.prescribed)) * (system.share > 0)[:, :, None]
    number = jnp.arange(groups.count)[:, None]
    right = right.at[number, groups.shared].add(pushes * groups.real[:, :, None])
    right = jnp.where(moves, right - system.copies_product(held), 0)
    found, info = implicit_solution(CopiesCondition(), (given, right), jnp.zeros_like(right))
    return jnp.where(moves, found, held), info


def differing(groups: Groups, shared: Array) -> Array:
    """Q: what shared copies (G, S, 3) differ by from their nodes' means."""
    held = shared * groups.real[:, :, None]
    sums = jnp.zeros((groups.copies.shape[0] + 1, 3), shared.dtype).at[groups.owner].add(held)
    mean = sums / jnp.append(groups.copies, 1)[:, None]
    return (held - mean[groups.owner]) * groups.real[:, :, None]


def shared_of(groups: Groups, field: Array) -> Array:
    """Shared copies (G, S, 3) of a field (G, N, 3)."""
    return jnp.take_along_axis(field, groups.shared[:, :, None], 1) * groups.real[:, :, None]


@dataclasses.dataclass(frozen=True)
class CopiesCondition:
    """Each group by itself: A v = right on the copies that move; `inputs`: (prepared, right)."""

    symmetric: bool = True

    def gradient(self, inputs: tuple[Prepared, Array], unknown: Array) -> Array:
        """The residual (G, N, 3)."""
        given, right = inputs
        moves = given.system.groups.free[:, :, None]
        return jnp.where(moves, given.system.copies_product(jnp.where(moves, unknown, 0)) - right, unknown)

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
    system, whole = given.system, given.matrices.whole
    moves, forth = system.groups.free[:, :, None], system.rotation

    def product(vector: Array) -> Array:
        return jnp.where(moves, system.copies_product(jnp.where(moves, vector, 0)), vector)

    def nearly(residual: Array) -> Array:
        found = turned(forth, times_flat(whole, turned(forth.swapaxes(1, 2), residual * moves)))
        return jnp.where(moves, found, residual)

    digits = 1e-13 if right.dtype.itemsize > 4 else 1e-6
    return pcg(product, right, nearly, tol=digits, max_iterations=system.max_iterations)
