"""Generalised alpha (Chung & Hulbert 1993): second order, with the damping of high frequencies in hand.

With numbers from rho, the share of the highest frequencies that a step leaves:
    a_m = (2 rho - 1)/(rho + 1), a_f = rho/(rho + 1), g = 1/2 - a_m + a_f, b = (1 - a_m + a_f)^2 / 4,
    M ((1 - a_m) a1 + a_m a0) = f at (1 - a_f) (x1, v1) + a_f (x0, v0)
    x1 = x0 + dt v0 + dt^2 ((1/2 - b) a0 + b a1),   v1 = v0 + dt ((1 - g) a0 + g a1).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from jaxfem.schemes.base import Moving, Scheme, Stage

Array = jax.Array

CONTINUATION = 12
"""Parts in which the eigenvalue is followed from slow modes to the one asked for."""


class Numbers(NamedTuple):
    """a_m, a_f, g and b of the head of this file."""

    mass: Array
    force: Array
    gamma: Array
    beta: Array


class GeneralizedAlpha(Scheme):
    """Second order in dt; a step leaves the share `rho_inf`, from 0 to 1, of the highest frequencies."""

    rho_inf: Any = 0.8

    name: ClassVar[str] = "generalized_alpha"
    order: ClassVar[int] = 2
    lanes: ClassVar[bool] = True

    @property
    def numbers(self) -> Numbers:
        """The least low-frequency damping for rho_inf in [0, 1]."""
        rho = jnp.asarray(self.rho_inf)
        mass, force = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
        return Numbers(mass, force, 0.5 - mass + force, 0.25 * (1 - mass + force) ** 2)

    def check(self) -> None:
        """ValueError unless rho_inf is from 0 to 1."""
        rho = self.rho_inf
        if isinstance(rho, jax.core.Tracer):
            return
        if not (jnp.ndim(rho) == 0 and jnp.issubdtype(jnp.result_type(rho), jnp.number) and 0 <= rho <= 1):
            raise ValueError(f"rho_inf is {rho!r}; it is the share of the highest frequencies left by a step, 0 to 1")

    def begin(self, state: Moving, acceleration: Callable[[], Array]) -> Array | None:
        """Those that the state carries, else those of the forces."""
        return acceleration() if state.accelerations is None else state.accelerations

    def stage(self, state: Moving, prescribed: Array, free: Array, dt: Array) -> Stage:
        """Strain and rate in between, rows linearised at the place that the old velocity leads to.

        That place is within O(dt^2) of the stage, so what is left of the rotations is of third order in a step.
        """
        n, velocities = self.numbers, state.velocities
        accelerations = jnp.zeros_like(velocities) if state.accelerations is None else state.accelerations
        reach = (1 - n.force) * n.beta / n.gamma * dt
        drift = (1 - n.force) * dt
        ahead = -reach * velocities + drift * dt * (0.5 - n.beta / n.gamma) * accelerations
        scale = n.gamma / (1 - n.mass)
        return Stage(
            base=state.positions + drift * velocities,
            ahead=jnp.where(free, ahead, (drift - reach) * prescribed - drift * velocities),
            before=n.force * velocities,
            start=velocities + dt * ((1 - n.gamma) - scale * n.mass) * accelerations,
            reach=reach,
            follow=1 - n.force,
            weight=scale * dt,
        )

    def advance(self, state: Moving, velocities: Array, free: Array, dt: Array) -> tuple[Array, Array | None]:
        """Newmark's formulas, solved for the new accelerations."""
        plain = state.positions + dt * velocities
        if state.accelerations is None:
            return plain, None
        n, old = self.numbers, state.accelerations
        new = (velocities - state.velocities) / (n.gamma * dt) - (1 - n.gamma) / n.gamma * old
        moved = state.positions + dt * state.velocities + dt**2 * ((0.5 - n.beta) * old + n.beta * new)
        return jnp.where(free, moved, plain), jnp.where(free, new, 0.0)

    def slope(self, turn: Array) -> Array:
        """z solves s^2 (1 + (1 - a_m) s) + turn^2 (1 + (1 - a_f) s) (1 + (g + 1/2) s + b s^2) = 0 with s = z - 1:
        followed from u = i at turn = 0 by Newton's method."""
        n = self.numbers

        def polynomial(u: Array, at: Array) -> Array:
            s = at * u
            return u**2 * (1 + (1 - n.mass) * s) + (1 + (1 - n.force) * s) * (1 + (n.gamma + 0.5) * s + n.beta * s**2)

        def trip(k: Array, u: Array) -> Array:
            at = turn * jnp.minimum(1, (k // 3 + 1) / CONTINUATION)
            value, rate = jax.jvp(partial(polynomial, at=at), (u,), (jnp.ones_like(u),))
            better: Array = u - value / rate
            return better

        found: Array = jax.lax.fori_loop(0, 3 * CONTINUATION + 3, trip, jnp.full(turn.shape, 1j))
        return found
