"""A step whose rotations are those of its end: rows made where the solution leads, solved again until they agree.

With x_a(v), v_a(v) where the scheme takes its forces (see `schemes`) and f the exact corotated force there,
    g(v) = M (v - v*) - weight f(x_a(v), v_a(v)) = 0.
Each round solves the rows made at the last v: Newton's method but for the turning of the rotations, whose share of the
tangent is small where steps are, and leaves a matrix that is always definite.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from jaxfem.answers import defined_at, described
from jaxfem.materials.constants import Constant
from jaxfem.methods.base import Elasticity, Facts, Method, Solved
from jaxfem.methods.by_rows import Impulses, solved_flaw
from jaxfem.methods.ending import ended
from jaxfem.methods.nodes.condensed import condensed_matrix, group_modes
from jaxfem.methods.nodes.preconditioner import two_level
from jaxfem.model import Model, Params, State, StepInfo
from jaxfem.pytrees import Pytree
from jaxfem.solvers.bicgstab import bicgstab
from jaxfem.solvers.implicit import implicit_solution, or_nan
from jaxfem.solvers.status import SolveInfo, Status
from jaxfem.system.momentum import kept, turning_status
from jaxfem.system.soft import (
    ROUNDING,
    System,
    elastic_rounding,
    momentum_gradient,
    prescribed_velocity,
    step_system,
)

Array = jax.Array

ROUNDS = 60
GROWTH = 10.0  # of the residual in a round, that is let pass: on the way into a large rotation it may rise first


class InRounds(Protocol):
    """What a method offers so that its steps can be solved in rounds."""

    guarded: bool
    """Whether a round that makes matters worse is halved."""

    def round(
        self, system: System, cache: Any, velocities: Array, impulses: Impulses | None, target: Array
    ) -> tuple[Solved, Array]:
        """With velocities of the free nodes (n, 3), and whether nothing is left to do; `target` [N s]: the residual at
        which the rounds end."""


class ImplicitRotations(Method):
    """Another method, in rounds until the rotations are those of the end of the step. For soft bodies alone."""

    inner: Any

    @property
    def name(self) -> str:  # type: ignore[override]
        """That of the method inside."""
        return str(self.inner.name)

    def refuses(self, facts: Facts) -> str | None:
        """Coupled scenes, what the method inside refuses, and methods inside whose steps are not made of rounds."""
        if facts.coupled:
            return (
                'with rotation_update = "implicit" is for soft bodies alone, without rigid bodies, joints or contacts: '
                'use rotation_update = "explicit"'
            )
        if facts.nonlinear:
            return (
                f'with rotation_update = "implicit" is for linear laws; {" and ".join(facts.nonlinear)} takes the '
                'force of the end of the step as it is: use rotation_update = "explicit"'
            )
        why: str | None = self.inner.refuses(facts)
        return why or self._without_rounds()

    def _without_rounds(self) -> str | None:
        line = type(self.inner).__mro__
        ranks = {name: defined_at(type(self.inner), name) for name in ("round", "step")}
        if ranks["round"] == len(line):
            return 'has no `round`, which rotation_update = "implicit" repeats: use rotation_update = "explicit"'
        if ranks["step"] < ranks["round"]:
            return (
                'has a `step` of its own, which rotation_update = "implicit" would pass over for the `round` of '
                f"{line[ranks['round']].__name__}: give it a `round` of its own too"
            )
        return None

    def constants(self) -> Mapping[Constant, float]:
        """As the method inside."""
        found: Mapping[Constant, float] = self.inner.constants()
        return found

    def elasticity(self, model: Model, params: Params, positions: Array, rates: Array) -> Elasticity | None:
        """As the method inside."""
        found: Elasticity | None = self.inner.elasticity(model, params, positions, rates)
        return found

    @property
    def own_elasticity(self) -> bool:
        """As the method inside."""
        return bool(self.inner.own_elasticity)

    def plan(self, model: Model, params: Params, state: State) -> Any:
        """As the method inside."""
        return self.inner.plan(model, params, state)

    def prepare(self, model: Model, params: Params, state: State, dt: Array) -> Any:
        """As the method inside."""
        return self.inner.prepare(model, params, state, dt)

    def start(self, model: Model, params: Params, state: State) -> Any:
        """As the method inside."""
        return self.inner.start(model, params, state)

    def impulses(self, model: Model, memory: Any) -> Impulses:
        """As the method inside."""
        found: Impulses = self.inner.impulses(model, memory)
        return found

    def step(
        self, model: Model, params: Params, state: State, dt: Array, forces: Array | None, cache: Any
    ) -> tuple[State, StepInfo]:
        """One step; `info.iterations` are those of all rounds."""
        inputs = _Inputs(model, params, state, dt, forces, cache)
        guess = jax.lax.stop_gradient((state.velocities, state.memory))
        unknown, (info, impulses) = implicit_solution(_EndOfStep(self.inner), inputs, guess)
        free = model.free[:, None] > 0
        velocities = jnp.where(free, unknown, prescribed_velocity(model, params, state, dt))
        velocities = kept(model, _system(inputs, unknown), state.positions, velocities, None)
        following, told = ended(model, params, state, dt, Solved(velocities, impulses, info), forces=forces)
        return following, told.replace(status=turning_status(model, params, state, dt, told.status))


class _Inputs(Pytree):
    model: Model
    params: Params
    state: State
    dt: Array
    forces: Array | None
    cache: Any


class _Rounds(Pytree):
    velocities: Array
    best: Array  # where the last solve started: steps that make things worse are halved towards it
    impulses: Any
    least: Array
    target: Array
    residual: Array
    iterations: Array
    rounds: Array
    status: Array


@dataclasses.dataclass(frozen=True)
class _EndOfStep:
    """g(v) = 0 on the velocities of free nodes. Damping in a turning frame has no potential: not symmetric."""

    inner: InRounds
    symmetric: bool = False

    def gradient(self, inputs: _Inputs, unknown: Array) -> Array:
        return momentum_gradient(_system(inputs, unknown), unknown)

    def solve(self, inputs: _Inputs, guess: Any) -> tuple[Array, tuple[SolveInfo, Any]]:
        velocities, impulses = guess
        return _solve(inputs, velocities, impulses, self.inner)

    def tangent_solve(self, inputs: _Inputs, unknown: Array, right: Array, matvec: Any) -> Array:
        system = _system(inputs, unknown)
        matrix, pattern = condensed_matrix(system), system.pattern
        inverse = two_level(matrix, group_modes(system), inputs.cache)

        def precondition(residual: Array) -> Array:
            return pattern.scattered(inverse(pattern.gathered(residual)))

        limit = system.max_iterations
        return or_nan(*bicgstab(matvec, right, precondition, tol=system.tolerance, max_iterations=limit))


def _system(inputs: _Inputs, around: Array) -> System:
    i = inputs
    return step_system(i.model, i.params, i.state, i.dt, i.forces, around)


def _round_flaw(answer: Any, like: Array) -> str:
    if isinstance(answer, tuple) and len(answer) == 2:
        return solved_flaw(answer[0], like)
    wanted = f"a Solved with velocities {like.shape}, and whether nothing is left to do"
    return f"{described(answer)}; it must give {wanted}"


def _round(inner: InRounds, cache: Any, s: _Rounds, system: System, residual: Array) -> _Rounds:
    """One solve of the method inside, with the rotations of the last."""
    answer: Any = inner.round(system, cache, s.velocities, s.impulses, s.target)
    if flaw := _round_flaw(answer, s.velocities):
        raise TypeError(f"`round` of {type(inner).__name__} gives {flaw}")
    found, nothing_left = answer
    info = found.info
    s = s.replace(status=jnp.where(nothing_left, info.status, s.status).astype(jnp.int32))
    failed = (info.status != int(Status.CONVERGED)) & (info.status != int(Status.ITERATION_LIMIT))
    status = jnp.where(failed, info.status, s.status).astype(jnp.int32)
    total = s.iterations + info.iterations
    return s.replace(
        velocities=found.velocities,
        best=s.velocities,
        impulses=found.impulses,
        least=jnp.minimum(residual, s.least),
        iterations=total,
        status=status,
    )


def _solve(inputs: _Inputs, velocities: Array, impulses: Any, inner: InRounds) -> tuple[Array, tuple[SolveInfo, Any]]:
    def trip(s: _Rounds) -> _Rounds:
        system = _system(inputs, s.velocities)
        # The limit counts the iterations of all rounds.
        system = system.replace(max_iterations=system.max_iterations - s.iterations)
        residual = jnp.linalg.norm(momentum_gradient(system, s.velocities))
        first = s.rounds == 0
        scale = jnp.where(first, residual, s.residual)
        # At rest all forces cancel: what the rounding of positions makes of the elastic ones cannot be solved away.
        floor = system.floor + noise
        target = jnp.where(first, jnp.maximum(system.tolerance * residual, system.floor), s.target)
        s = s.replace(target=target, residual=scale, rounds=s.rounds + 1)
        # Below the floor a round is let be the last once it gains nothing: small loads are felt as far as digits go.
        done = (residual <= target) | ((residual <= floor) & ~first & (residual > 0.5 * s.least))
        status = jnp.where(done, int(Status.CONVERGED), int(Status.ITERATION_LIMIT))
        status = jnp.where(first & ~jnp.isfinite(residual), int(Status.NOT_FINITE), status).astype(jnp.int32)
        s = s.replace(status=status)
        halved = s.replace(velocities=0.5 * (s.velocities + s.best))
        ended = s.replace(least=residual)
        worse = ~(residual <= GROWTH * s.least) & inner.guarded
        choice = jnp.where(status != int(Status.ITERATION_LIMIT), 0, jnp.where(worse, 1, 2))
        branches = (lambda: ended, lambda: halved, lambda: _round(inner, inputs.cache, s, system, residual))
        following: _Rounds = jax.lax.switch(choice, branches)
        return following

    def running(s: _Rounds) -> Array:
        left = s.iterations < inputs.model.max_iterations
        return (s.status == int(Status.ITERATION_LIMIT)) & (s.rounds < ROUNDS) & left

    noise = ROUNDING * inputs.dt * elastic_rounding(inputs.model, inputs.params, inputs.state.positions)
    free = inputs.model.free[:, None]
    infinite = jnp.full((), jnp.inf, velocities.dtype)
    zero, limit = jnp.int32(0), jnp.int32(Status.ITERATION_LIMIT)
    start = velocities * free
    s = _Rounds(start, start, impulses, infinite, infinite, infinite, zero, zero, limit)
    end = jax.lax.while_loop(running, trip, s)
    relative = end.least / jnp.where(end.residual > 0, end.residual, 1)
    return end.velocities, (SolveInfo(end.status, end.iterations, relative, zero), end.impulses)
