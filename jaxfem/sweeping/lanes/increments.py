"""The increment of velocities of a step with lanes last, and its derivative by the condition that it meets.

The condition is linear in the increment: what is left to do at v + dv is b - H dv, and 0 at the solution. So
H d(dv) = d(what is left), dv held: one more solve with the same matrix and preconditioner, also backwards.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxfem.pytrees import Pytree
from jaxfem.schemes import Stage
from jaxfem.solvers.differentiation import solved
from jaxfem.sweeping.lanes.body import Body
from jaxfem.sweeping.lanes.force import Strained, elastic_force
from jaxfem.sweeping.lanes.kernels import CYCLES, diagonal_blocks, inverses, pairing, strain_force, tied, times
from jaxfem.sweeping.lanes.solve import SINGLE, Linear, Outcome, modal, norm, refined, solve

Array = jax.Array


class Lane(Pytree):
    """What of a variant does not change in a run: `lam`, `mu`, `beta` (E + 1, lanes) or (1, lanes), `mass`
    (n, 1, lanes), `weight` (n, 3, lanes) [N], and relative to the body's modes the mean `stiffness` and `density`
    (lanes,), with the mean `damping` [s]. `drag` (n, 1, lanes) [1/s]: mass-proportional damping, None without.
    `shared` (E + 1, lanes) [kg]: what ties the corners of elements where masses are not lumped, else None.
    """

    lam: Array
    mu: Array
    beta: Array
    mass: Array
    weight: Array
    stiffness: Array
    density: Array
    damping: Array
    drag: Array | None = None
    shared: Array | None = None


class Frames(Pytree):
    """Rotations of a step (E + 1, 3, 3, lanes), and `turned` (E + 1, 4, 3, lanes): R grad N_a; held.

    Those of the step's start, turned on by `ahead` (b, 3, 3, lanes), None without free bodies.
    """

    rotations: Array
    turned: Array
    ahead: Array | None


class Equation(Pytree):
    """What a step's solution depends on: the scheme's `stage`, the `lane`, weight and loads as impulses `load`, and the
    `velocities` (n, 3, lanes) from which the increment leads; `ahead`: that of the frames, with its derivative;
    `known` (n, 3, lanes): velocities before the step, of held nodes too, where masses are not lumped."""

    stage: Stage
    lane: Lane
    load: Array
    velocities: Array
    ahead: Array | None
    known: Array | None = None


class Effort(Pytree):
    """How far to solve: to a residual of `tolerance` () relative to the right side or `floor` (lanes,), in at most
    `limit` iterations, for the lanes `asked` (lanes,)."""

    tolerance: Array
    floor: Array
    limit: Array
    asked: Array


def increment(body: Body, frames: Frames, equation: Equation, effort: Effort) -> tuple[Array, Outcome]:
    """(dv (nf, 3, lanes), outcome); differentiable in the equation, where the derivative of a lane that is not
    converged is NaN."""
    found: tuple[Array, Outcome] = solved(_solve, _change, body, frames, equation, effort)
    return found


def left(body: Body, frames: Frames, equation: Equation, change: Array | None) -> Array:
    """The momentum that is left to do at the velocities and a `change` (nf, 3, lanes) of them, (nf, 3, lanes)."""
    stage, lane, v, free = equation.stage, equation.lane, equation.velocities, body.free_count
    if change is not None:
        v = jnp.concatenate([v[:free] + change, v[free:]])
    place = stage.base + stage.reach * v if stage.ahead is None else stage.base + stage.ahead + stage.reach * v
    rate = stage.follow * v if stage.before is None else stage.before + stage.follow * v
    base, spin = _turned_on(body, frames, equation)
    if lane.beta.shape[0] == 1:  # one damping for all elements: both in one pass
        strained = Strained(base, place + lane.beta * rate, None, lane.lam, lane.mu, None, spin)
    else:
        strained = Strained(base, place, rate, lane.lam, lane.mu, lane.beta, spin)
    force = elastic_force(body, frames.turned, strained)
    if lane.drag is not None:
        force = force + lane.mass * lane.drag * rate
    found = lane.mass * (stage.start - v) + equation.load - stage.weight * force
    if lane.shared is not None and equation.known is not None:
        change = v - equation.known
        found = found - tied(
            body, lane.shared, change if lane.drag is None else change + stage.weight * lane.drag * rate
        )
    return found[:free]


def _turned_on(body: Body, frames: Frames, equation: Equation) -> tuple[Array, Array | None]:
    """The base turned on as the rotations are, and how these turn beside it (E + 1, 3, lanes): 0, with a derivative."""
    base, ahead = equation.stage.base, equation.ahead
    if body.loose is None or frames.ahead is None or ahead is None:
        return base, None
    turned = body.loose.spread(frames.ahead)
    base = sum((turned[:, :, j] * base[:, None, j] for j in (1, 2)), turned[:, :, 0] * base[:, None, 0])
    # ahead frames' is 1, and its change is skew of the spin; not fenced, which would be one more thing to transpose.
    turn = (ahead[:, :, None] * frames.ahead[:, None]).sum(3)
    spin = 0.5 * jnp.stack([turn[:, j, i] - turn[:, i, j] for i, j in CYCLES], 1)
    every = body.loose.of_elements(spin)
    return base, jnp.broadcast_to(every, (len(body.corners), *every.shape[1:]))


def inertia(stage: Stage, lane: Lane) -> Array:
    """Masses (n, 1, lanes) that the new velocities are felt by: those of drag are in them, see `system/drag.py`."""
    return lane.mass if lane.drag is None else lane.mass * (1 + stage.weight * lane.drag * stage.follow)


def stiffness(body: Body, equation: Equation) -> tuple[Array, Array]:
    """What of a step lambda and mu (E + 1 or 1, lanes) come to, in the matrix on the velocities."""
    lane = equation.lane
    reach, follow, weight = (each_element(body, v) for v in _numbers(equation.stage))
    share = weight * (reach + lane.beta * follow)
    return share * lane.lam, share * lane.mu


def operators(body: Body, frames: Frames, equation: Equation) -> tuple[Linear, Linear]:
    """The matrix M + weight (reach + beta follow) K on the free nodes, and its preconditioner."""
    stage, lane, free = equation.stage, equation.lane, body.free_count
    lam, mu = stiffness(body, equation)
    still, mass = jnp.zeros_like(equation.velocities[free:]), inertia(stage, lane)[:free]

    def matrix(p: Array) -> Array:
        gradient = pairing(body, jnp.concatenate([p, still]), frames.turned)
        found: Array = mass * p + strain_force(body, frames.turned, gradient, lam, mu)[:free]
        if lane.shared is None:
            return found
        felt = p if lane.drag is None else p * (1 + stage.weight * lane.drag * stage.follow)[:free]
        return found + tied(body, lane.shared, jnp.concatenate([felt, still]))[:free]

    modes = modal(body, frames.rotations, *_relative(body, stage, lane))
    if body.complete:
        return matrix, modes
    near = inverses(body, diagonal_blocks(body, frames.turned, lam, mu, inertia(stage, lane)))
    return matrix, lambda x: modes(x) + times(body, near, x)


def _relative(body: Body, stage: Stage, lane: Lane) -> tuple[Array, Array]:
    """Stiffness and density (lanes,) of a step's matrix, relative to those of the modes."""
    reach, follow, weight = map(_mean, _numbers(stage))
    scale = weight * (reach + lane.damping * follow) * lane.stiffness * body.stiffness / body.density
    if lane.drag is None:
        return scale, lane.density
    mass = lane.mass[: body.free_count]
    return scale, lane.density * inertia(stage, lane)[: body.free_count].sum((0, 1)) / mass.sum((0, 1))


def each_element(body: Body, value: Array) -> Array:
    """One of a stage's numbers (n, 1, lanes), the same on the nodes of an element, of elements (E + 1, lanes); those
    that all nodes share as they are."""
    return value[body.corners[:, 0], 0] if value.ndim > 1 else value


def _numbers(stage: Stage) -> tuple[Array, Array, Array]:
    return stage.reach, stage.follow, stage.weight


def _mean(value: Array) -> Array:
    """Of what nodes may differ in, (lanes,)."""
    return value.mean((0, 1)) if value.ndim > 1 else value


def _solve(body: Body, frames: Frames, equation: Equation, effort: Effort) -> tuple[Array, Outcome]:
    b = left(body, frames, equation, None)
    target = jnp.maximum(effort.tolerance * norm(b), effort.floor)
    return _linear(body, frames, equation)(b, target, effort)


def _linear(body: Body, frames: Frames, equation: Equation) -> Callable[[Array, Array, Effort], tuple[Array, Outcome]]:
    """Function of (b, target, effort) that solves with the step's matrix."""
    matrix, precondition = operators(body, frames, equation)
    if frames.turned.dtype == SINGLE:
        return lambda b, target, effort: solve(matrix, precondition, b, target, effort.asked, effort.limit)

    def single(leaf: Any) -> Any:
        return jnp.asarray(leaf, SINGLE) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf

    low = operators(*jax.tree.map(single, (body, frames, equation)))
    return lambda b, target, effort: refined(matrix, precondition, low, b, target, effort.asked, effort.limit)


def _change(found: Array, __: Outcome, arguments: Any, pushed: Callable[[Callable[..., Any]], Any]) -> Array:
    body, frames, equation, effort = arguments
    right = pushed(lambda body, frames, equation, effort: left(body, frames, equation, found))
    matrix, _ = operators(body, frames, equation)
    linear = _linear(body, frames, equation)

    def solution(_: Linear, b: Array) -> Array:
        # Squares of what is small in SI units are lost in single precision: b has a size of 1.
        size = jnp.abs(b).max((0, 1))
        size = jnp.where(size > 0, size, 1)
        x, outcome = linear(b / size, effort.tolerance * norm(b / size), effort)
        return jnp.where(outcome.converged | ~effort.asked, size * x, jnp.nan)

    change: Array = jax.lax.custom_linear_solve(matrix, right, solution, symmetric=True)
    return change
